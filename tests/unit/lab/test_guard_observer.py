"""Tests of the guard's reports without action, and of the actions that remain."""

from dataclasses import replace

import pytest

from tetractl.core.clock import SECOND
from tetractl.core.guard_check import GuardCheck
from tetractl.core.guard_findings import Abort, Excess, Warn
from tetractl.core.poses import CameraFrame, Pose
from tetractl.core.setup import Bounds
from tetractl.lab.guard import Guard, GuardState, Ruling
from tetractl.lab.guard_observer import (
    Action,
    GuardObserver,
    ObservingCheck,
    build_guard,
    name_check,
)
from tetractl.lab.guard_rules import GuardRules
from tetractl.spec.lab_section import LabLimits

pytestmark = pytest.mark.slow

FRAME_NS = SECOND // 125
SPEED = 200.0
RULES = GuardRules(
    names=("green", "blue"),
    speeds=(SPEED, SPEED),
    turning=(6.0, 6.0),
    arena=Bounds(0.0, 0.0, 2000.0, 2000.0),
    limits=LabLimits(observe=True),
    wheel_radius=40.0,
)
ACTING = replace(RULES, limits=LabLimits())


def course(t_s, x=300.0, y=500.0):
    """A robot that drives along x from the first command on."""
    return Pose(x + SPEED * t_s, y, 0.0)


def honest(t_s):
    return course(t_s), course(t_s, y=1000.0)


def turned(t_s):
    """The heading shown of green turns by 1.5 rad/s from 0.5 s on, though it drives straight."""
    pose = course(t_s)
    return replace(pose, heading=max(0.0, 1.5 * (t_s - 0.5))), course(t_s, y=1000.0)


def frozen(t_s):
    """Green's pose repeats from 0.5 s on."""
    return course(min(t_s, 0.5)), course(t_s, y=1000.0)


def jumps(t_s):
    """Green is shown 300 mm to the side from 0.5 s on."""
    return course(t_s, y=800.0 if t_s > 0.5 else 500.0), course(t_s, y=1000.0)


def to_the_edge(t_s):
    """Green starts 100 mm before the edge."""
    return course(t_s, x=1900.0), course(t_s, y=1000.0)


class Play:
    """Shows two robots to a guard or an observer at 125 Hz, and sends both straight ahead."""

    def __init__(self, guard):
        self.guard = guard
        self.warnings = []
        self.rulings = []

    def run(self, shown, seconds):
        guard = self.guard
        frames = round(seconds * 125)
        for k in range(-3, frames):
            now_ns = SECOND + k * FRAME_NS
            if k == 0:
                guard.start_run(now_ns)
            frame = CameraFrame(k + 4, now_ns, now_ns, shown(max(0, k) * FRAME_NS / SECOND))
            self._check(now_ns, frame)
            if k == -1 and isinstance(guard, Guard):
                guard.pass_preflight()
            if k < 0:
                continue
            guard.record_direction(now_ns)
            guard.record_transmission(now_ns, (SPEED, SPEED), (0.0, 0.0))
            ruling = guard.decide(now_ns)
            if ruling is not None:
                self.rulings.append(ruling)
                self.warnings += ruling.warnings
        return self

    def _check(self, now_ns, frame):
        if isinstance(self.guard, Guard):
            self.guard.check_frame(frame)
        else:
            self.guard.check_frame(now_ns, frame)


def test_a_false_pose_stops_nobody_in_observe_mode_and_is_reported():
    acting = Play(build_guard(ACTING)).run(turned, 2)
    assert acting.guard.state is GuardState.ABORT
    observing = Play(build_guard(RULES)).run(turned, 2)
    assert all(ruling.moving == (True, True) for ruling in observing.rulings)
    first = observing.warnings[0]
    assert first.startswith("observed: the motion check would have ended the run: green moves")
    assert "rad, limit" in first
    assert acting.guard.reason in first  # as the acting guard says it


def test_an_honest_drive_is_reported_by_no_check():
    observing = Play(build_guard(RULES)).run(honest, 4)
    assert observing.warnings == []
    observer = Play(GuardObserver(ACTING)).run(honest, 4).guard
    assert observer.interventions == []
    assert observer.watched_ns == pytest.approx(4 * SECOND, abs=2 * FRAME_NS)


@pytest.mark.parametrize(
    ("shown", "reason"),
    [(to_the_edge, "green is about to leave the arena"), (jumps, "green is not tracked: its pose")],
)
def test_the_kernel_acts_in_observe_mode(shown, reason):
    play = Play(build_guard(RULES)).run(shown, 2)
    assert play.guard.state is GuardState.ABORT
    assert play.guard.reason.startswith(reason)
    assert not any("observed" in warning for warning in play.warnings)


def test_a_frozen_pose_is_refused_in_observe_mode_as_it_is_not_fresh():
    play = Play(build_guard(RULES)).run(frozen, 2)
    assert play.guard.state is GuardState.ABORT
    assert "its pose repeats" in play.guard.reason


def test_a_camera_that_goes_silent_stops_all_in_observe_mode():
    play = Play(build_guard(RULES)).run(honest, 1)
    silent_ns = SECOND + 124 * FRAME_NS
    play.guard.record_direction(silent_ns + SECOND // 10)
    assert play.guard.decide(silent_ns + SECOND // 8).moving == (False, False)
    play.guard.record_direction(silent_ns + SECOND // 2)
    assert play.guard.decide(silent_ns + SECOND // 2).state is GuardState.ABORT


def test_an_observer_names_check_robot_value_and_limit_and_goes_on():
    """A body that turns on and on ends the run again and again, each time by a new guard."""
    observer = Play(GuardObserver(ACTING)).run(turned, 4).guard
    ends = [it for it in observer.interventions if it.act is Action.ENDS]
    assert len(ends) >= 2
    assert {(it.check, it.robot) for it in ends} <= {("motion", "green"), ("drift", "green")}
    first = ends[0].excess  # it has turned further to the left than commands allow
    assert (first.check, first.unit) == ("motion", "rad")
    assert first.value > first.limit > 0
    refused = [it for it in observer.interventions if it.act is Action.REFUSES]
    assert 0 < refused[0].t_ns - SECOND - SECOND // 2 < SECOND
    # between two guards no run is watched: a new one has to see both robots first
    assert 3 * SECOND < observer.watched_ns < 4 * SECOND


def test_without_observe_the_guard_is_the_plain_one():
    assert type(build_guard(ACTING)) is Guard


class Ticks(GuardCheck):
    """Stands for a plug-in's statistical check that looks at each decision."""

    statistical = True

    def check_places(self, robots):
        yield Warn("green is slow")
        yield Abort("green is too slow")


def test_a_statistical_check_of_decisions_is_asked_and_only_warns_in_observe_mode():
    """Regression: it was never asked, so it saw nothing and could not warn."""
    assert list(ObservingCheck(Ticks()).check_places(())) == [Warn("green is slow")]


def test_a_reason_of_a_plug_in_is_not_counted_as_one_of_the_guards_own():
    """Regression: every reason without a number was counted as a wrong height."""
    assert name_check("green left the carpet", None) == "other"
    assert name_check("its body is tilted by 0.31 rad", None) == "height"


def test_a_robot_that_was_replaced_is_watched_as_a_new_one():
    """Regression: the observer compared it with the body that was lost."""
    rules = replace(RULES, limits=LabLimits(observe=True, untracked_abort=10))
    guard = build_guard(rules)

    def elsewhere(t_s):
        """Another body stands in for green, 300 mm to the side, from 0.5 s on."""
        if t_s > 0.5 and not replaced:
            replaced.append(t_s)
            guard.replace_robot(0)
        return course(t_s, y=800.0 if t_s > 0.5 else 500.0), course(t_s, y=1000.0)

    replaced = []
    play = Play(guard).run(elsewhere, 2)
    assert play.guard.state is GuardState.RUN
    assert play.warnings == []


class ScriptedGuard:
    """Stands for a guard whose state and findings a test sets."""

    def __init__(self):
        self.state = GuardState.RUN
        self.refusal_reasons = ("", "")
        self.moving = (True, True)
        self.hidden = ()
        self.lost_robots = {}
        self.is_tracking_all = True
        self.reason = "too far"
        self.excess = None
        self.calls = []

    def __getattr__(self, name):
        return lambda *arguments: self.calls.append((name, *arguments))

    def refusal_excess(self, i):
        return (
            Excess("motion", 9.0, 5.0, "mm", i) if self.refusal_reasons[i] == "it moves" else None
        )

    def is_hidden(self, i):
        return i in self.hidden

    def decide(self, now_ns):
        return Ruling(self.state, self.moving, (None, None))


def scripted():
    """An observer of a run since 1 s, and its guard."""
    observer = GuardObserver(ACTING)
    observer._guard = guard = ScriptedGuard()
    observer.start_run(SECOND)
    return observer, guard


def noted(observer):
    return [(i.t_ns, i.act, i.robot, i.text, i.check) for i in observer.interventions]


def test_only_the_time_in_which_a_guard_decides_about_a_run_counts_as_watched():
    observer, guard = scripted()
    observer.start_run(7 * SECOND)
    assert [name for name, *_ in guard.calls] == ["start_run"], "a run begins once"
    observer.decide(3 * SECOND)
    assert observer.watched_ns == 2 * SECOND
    guard.state = GuardState.READY
    observer.decide(4 * SECOND)
    assert observer.watched_ns == 2 * SECOND
    guard.state = GuardState.HOLD
    observer.decide(5 * SECOND)
    assert observer.watched_ns == 4 * SECOND
    observer.end_run()
    observer.decide(9 * SECOND)
    assert observer.watched_ns == 4 * SECOND
    assert noted(observer) == []


def test_a_pose_that_stays_refused_and_a_robot_that_stays_stopped_count_once():
    observer, guard = scripted()
    for k, (text, moves) in enumerate([("it moves", False), ("it moves", False), ("", True)] * 2):
        guard.refusal_reasons = ("", text)
        guard.moving = (True, moves)
        observer.check_frame(k, CameraFrame(k, k, k, (None, None)))
        observer.decide(k)
    expected = [
        (k, act, "blue", "it moves", "motion")
        for k in (0, 3)
        for act in (Action.REFUSES, Action.STOPS)
    ]
    assert noted(observer) == expected
    assert observer.interventions[0].excess == Excess("motion", 9.0, 5.0, "mm", 1)


@pytest.mark.parametrize(
    ("hidden", "text", "check"),
    [((0,), "it is not tracked", "tracking"), ((), "no new frame came", "frame")],
)
@pytest.mark.parametrize("state", [GuardState.RUN, GuardState.HOLD])
def test_a_robot_that_stops_without_a_refused_pose_is_not_tracked_or_has_no_frame(
    hidden, text, check, state
):
    observer, guard = scripted()
    guard.state, guard.hidden, guard.moving = state, hidden, (False, True)
    observer.decide(5)
    assert noted(observer) == [(5, Action.STOPS, "green", text, check)]


def test_a_lost_robot_that_stops_is_not_reported_again():
    observer, guard = scripted()
    guard.lost_robots, guard.moving = {0: 3}, (False, True)
    observer.decide(5)
    assert noted(observer) == []


@pytest.mark.parametrize(
    ("excess", "robot", "check"),
    [(None, "", "other"), (Excess("arena", 1.0, 0.0, "mm", 1), "blue", "arena")],
)
def test_an_end_of_the_run_is_reported_and_a_new_guard_knows_what_was_sent_lately(
    excess, robot, check
):
    observer, guard = scripted()
    for t_s in (0, 1, 2, 3):
        observer.record_transmission(t_s * SECOND, (t_s, 0.0), (0.0, 0.0))
    assert [sent.sent_ns // SECOND for sent in observer._recent_commands] == [1, 2, 3]
    guard.state, guard.excess = GuardState.ABORT, excess
    observer.record_step(4 * SECOND, was_late=True)
    assert ("record_step", True) in guard.calls
    assert noted(observer) == [(4 * SECOND, Action.ENDS, robot, "too far", check)]
    assert isinstance(observer._guard, Guard)
    assert observer._guard.state is GuardState.READY


@pytest.mark.parametrize("tracks_all", [True, False])
def test_a_new_guard_watches_once_it_sees_all_robots_with_the_last_direction(tracks_all):
    observer, guard = scripted()
    observer.record_direction(2 * SECOND, ahead=False)
    guard.state, guard.is_tracking_all = GuardState.READY, tracks_all
    guard.calls.clear()
    observer.check_frame(3 * SECOND, CameraFrame(1, 0, 0, (None, None)))
    started = [("start_run", 3 * SECOND), ("record_direction", 2 * SECOND, False)]
    assert guard.calls[1:] == (started if tracks_all else [])


def test_nothing_is_reported_of_frames_outside_a_run():
    observer, guard = scripted()
    observer.end_run()
    guard.refusal_reasons, guard.state = ("it moves", ""), GuardState.ABORT
    observer.check_frame(5, CameraFrame(1, 0, 0, (None, None)))
    assert noted(observer) == []

"""Tests of the guard's reports without action, and of the actions that remain."""

from dataclasses import replace

import pytest

from tetractl.core.clock import SECOND
from tetractl.core.guard_check import GuardCheck
from tetractl.core.guard_findings import Abort, Warn
from tetractl.core.poses import CameraFrame, Pose
from tetractl.core.setup import Bounds
from tetractl.lab.guard import Guard, GuardState
from tetractl.lab.guard_observer import Act, GuardObserver, Unheeded, build_guard, check_of
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
            guard.note_direction(now_ns)
            guard.note_transmission(now_ns, (SPEED, SPEED), (0.0, 0.0))
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
    play.guard.note_direction(silent_ns + SECOND // 10)
    assert play.guard.decide(silent_ns + SECOND // 8).moving == (False, False)
    play.guard.note_direction(silent_ns + SECOND // 2)
    assert play.guard.decide(silent_ns + SECOND // 2).state is GuardState.ABORT


def test_an_observer_names_check_robot_value_and_limit_and_goes_on():
    """A body that turns on and on ends the run again and again, each time by a new guard."""
    observer = Play(GuardObserver(ACTING)).run(turned, 4).guard
    ends = [it for it in observer.interventions if it.act is Act.ENDS]
    assert len(ends) >= 2
    assert {(it.check, it.robot) for it in ends} <= {("motion", "green"), ("drift", "green")}
    first = ends[0].excess  # it has turned further to the left than commands allow
    assert (first.check, first.unit) == ("motion", "rad")
    assert first.value > first.limit > 0
    refused = [it for it in observer.interventions if it.act is Act.REFUSES]
    assert 0 < refused[0].t_ns - SECOND - SECOND // 2 < SECOND
    # between two guards no run is watched: a new one has to see both robots first
    assert 3 * SECOND < observer.watched_ns < 4 * SECOND


def test_without_observe_the_guard_is_the_plain_one():
    assert type(build_guard(ACTING)) is Guard


class Ticks(GuardCheck):
    """Stands for a plug-in's statistical check that looks at each decision."""

    statistical = True

    def tick(self, robots):
        yield Warn("green is slow")
        yield Abort("green is too slow")


def test_a_statistical_check_of_decisions_is_asked_and_only_warns_in_observe_mode():
    """Regression: it was never asked, so it saw nothing and could not warn."""
    assert list(Unheeded(Ticks()).tick(())) == [Warn("green is slow")]


def test_a_reason_of_a_plug_in_is_not_counted_as_one_of_the_guards_own():
    """Regression: every reason without a number was counted as a wrong height."""
    assert check_of("green left the carpet", None) == "other"
    assert check_of("its body is tilted by 0.31 rad", None) == "height"


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

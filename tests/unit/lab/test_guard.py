"""Tests of the guard with two robots: accepted frames, allowed motion, and reasons to end a run."""

import math
import random
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from tetractl.core.clock import SECOND
from tetractl.core.guard_check import GuardCheck
from tetractl.core.guard_findings import Abort, Lose, Warn
from tetractl.core.poses import CameraFrame, Pose
from tetractl.core.setup import Bounds
from tetractl.core.shape import Shape
from tetractl.lab.drift_check import DriftCheck
from tetractl.lab.frame_buffer import FrameBuffer
from tetractl.lab.guard import BUSY_BEFORE, Guard, GuardState
from tetractl.lab.guard_checks import robot_checks
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.motion_check import PUSHED_QUESTION
from tetractl.spec.lab_section import REACTION_S, UNTRACKED_STOP_S, LabLimits

pytestmark = pytest.mark.slow

MS = 1_000_000
FRAME = 8 * MS
"""Time between two frames [ns]."""
FRAMES_A_SECOND = SECOND // FRAME
RULES = GuardRules(
    names=("green", "blue"),
    speeds=(200.0, 100.0),
    turning=(6.0, 3.0),
    arena=Bounds(0.0, 0.0, 2000.0, 2000.0),
    limits=LabLimits(),
)
GOES_ON = replace(RULES, may_lose_robots=True)
"""Rules of a run that goes on without a robot that is lost."""
PLACES = (Pose(500.0, 500.0, 0.3), Pose(500.0, 1500.0, -2.0))
GREEN_UNSEEN = (None, PLACES[1])
UNTIL_LOST = 40
"""Number of frames, 0.32 s, after which a robot that is not seen in them is lost."""


class Course:
    """A guard fed frames at 125 Hz; `now_ns` is the time of the last one, and `accepted` what the
    guard made of it. `damaged` is the number of damaged frames so far.

    Its stages: `pass_preflight`, `start_run`, then `frame` and `frames`, which let it decide after
    each frame.
    """

    def __init__(self, rules=RULES, checks_of=robot_checks):
        self.guard = Guard(rules, checks_of)
        self.now_ns = 0
        self.number = 0
        self.damaged = 0
        self.accepted = None

    def pass_preflight(self, poses=PLACES):
        self.frames(3, poses)
        self.guard.pass_preflight()
        return self

    def start_run(self):
        self.guard.start_run(self.now_ns)
        return self

    def frame(self, poses=PLACES, fault="", step=FRAME):
        self.now_ns += step
        self.number += 1
        frame = CameraFrame(self.number, self.now_ns, self.now_ns, tuple(poses), fault=fault)
        self.accepted = self.guard.check_frame(frame)
        return self.tick()

    def tick(self, after=0, failure=None):
        return self.guard.decide(self.now_ns + after, self.damaged, failure)

    def frames(self, count, poses=PLACES):
        for _ in range(count):
            ruling = self.frame(poses)
            self.guard.record_direction(self.now_ns)
        return ruling


def running(rules=RULES, poses=PLACES, checks_of=robot_checks):
    """A course whose robots drive."""
    course = Course(rules, checks_of)
    course.pass_preflight(poses).start_run()
    assert course.frames(2, poses).moving == (True, True)
    return course


def checks_of_robots_that_stop(rules, together):
    return replace(robot_checks(rules), together=together)


def begun_with_checks(*checks, rules=GOES_ON):
    """A course at the beginning of its run, with these checks alone."""

    def checks_of(rules):
        return replace(robot_checks(rules), checks=checks)

    return Course(rules, checks_of).pass_preflight().start_run()


def test_a_robot_that_may_be_faster_does_not_jump():
    course = running(replace(RULES, speeds=(2000.0, 100.0)))
    course.frame((Pose(540.0, 500.0, 0.3), PLACES[1]))  # 40 mm in 8 ms: 5 m/s
    assert course.guard.refusal_reasons[0] != "its pose jumped"


def test_nothing_moves_before_go():
    course = Course()
    assert not any(course.frames(5).moving)
    course.guard.start_run(course.now_ns)  # not passed the preflight yet
    assert course.frames(1).state is GuardState.PREFLIGHT
    course.guard.pass_preflight()
    assert course.frames(1).state is GuardState.READY
    assert not any(course.frames(1).moving)


def test_a_stream_that_stops_stops_all_at_100_ms_and_aborts_at_500():
    course = running()
    assert course.tick(after=100 * MS).moving == (True, True)
    held = course.tick(after=101 * MS)
    assert (held.state, held.moving) == (GuardState.HOLD, (False, False))
    for late in range(120, 500, 20):
        assert course.tick(after=late * MS).state is GuardState.HOLD
    ended = course.tick(after=500 * MS)
    assert ended.state is GuardState.ABORT
    assert course.guard.reason == "no new camera frame for 0.50 s"


def test_an_actuator_that_can_send_no_more_ends_the_run():
    course = running()
    ended = course.tick(failure="the radio is gone")
    assert (ended.state, ended.moving) == (GuardState.ABORT, (False, False))
    assert course.guard.reason == "the radio is gone"


def test_old_frames_that_come_late_are_no_new_frames():
    course = running()
    now = course.now_ns + 200 * MS
    course.guard.decide(now - 80 * MS)
    for i in range(5):  # a burst from a socket's buffer, exposed long ago
        course.guard.check_frame(CameraFrame(99 + i, course.now_ns + (i + 1) * FRAME, now, PLACES))
    assert course.guard.decide(now).moving == (False, False)


def test_an_untracked_robot_stops_after_50_ms_alone_and_the_run_aborts_at_300():
    course = running()
    moving = [course.frames(1, GREEN_UNSEEN).moving for _ in range(10)]
    assert moving[5] == (True, True)  # 48 ms
    assert moving[6] == (False, True)  # 56 ms
    assert course.guard.state is GuardState.HOLD
    course.frames(26, GREEN_UNSEEN)  # 288 ms
    assert course.guard.state is GuardState.HOLD
    course.frames(2, GREEN_UNSEEN)  # 304 ms
    assert course.guard.state is GuardState.ABORT
    assert course.guard.reason.startswith("green is not tracked")


def test_a_robot_that_is_seen_for_moments_only_ends_the_run():
    """Regression: seen for 24 ms of every 304, a robot drove on to the end of the trial.

    A pose is recent for 100 ms: of 304 ms, 192 count as unseen, less a quarter of 112, which are
    164. Once they are more than three times the 0.3 s of `untracked_abort`, the run ends: in the
    sixth round, while 156 of its first 256 ms count (5 x 164 + 156 = 976 ms), and not before.
    """
    course = running()
    began = course.now_ns
    while course.guard.state is not GuardState.ABORT and course.now_ns - began < 5 * SECOND:
        course.frames(35, GREEN_UNSEEN)
        course.frames(3)
    assert "green is seen too rarely" in course.guard.reason
    rounds = (course.now_ns - began) / (38 * FRAME)
    assert rounds == 6


@pytest.mark.parametrize(("period_ms", "goes_on"), [(167, False), (120, True)])
def test_a_camera_that_is_too_slow_for_the_limits_ends_the_run(period_ms, goes_on):
    """Regression: before a camera at 6 Hz robots were stopped and let go for ever."""
    course = running()
    for _ in range(60):
        course.guard.record_direction(course.now_ns)
        course.frame(step=period_ms * MS)
    assert (course.guard.state is not GuardState.ABORT) == goes_on, course.guard.reason


@pytest.mark.parametrize("together", [False, True])
def test_a_run_that_goes_on_leaves_out_a_lost_robot_for_good_and_ends_with_the_last(together):
    checks_of = partial(checks_of_robots_that_stop, together=together)
    course = running(GOES_ON, checks_of=checks_of)
    guard = course.guard
    ruling = course.frames(UNTIL_LOST, GREEN_UNSEEN)
    assert list(guard.lost_robots) == [0]
    assert ruling.moving == (together, True)
    assert ruling.state is GuardState.RUN
    course.frames(5)  # it is there again
    assert course.accepted.is_fresh == (False, True)
    guard.replace_robot(0)
    assert course.frames(5).state is GuardState.RUN
    assert course.accepted.is_fresh == (True, True)
    course.frames(UNTIL_LOST, GREEN_UNSEEN)
    course.frames(UNTIL_LOST, (None, None))
    assert guard.state is GuardState.ABORT
    assert guard.reason.startswith(("green", "blue"))


class Writes(GuardCheck):
    """Stands for a check that writes down by which question it was asked about which robot."""

    def __init__(self):
        self.asked = []

    def check_pose(self, robot, before, pose):
        self.asked.append(("pose", robot))
        yield from ()

    def check_pause(self, robot, before, pose, now_ns):
        self.asked.append(("pause", robot))
        yield from ()


def test_the_pose_in_the_frame_whose_loss_ends_the_run_is_compared_with_its_commands():
    """Regression: the last robot's loss was recorded first, and its pose compared as in a pause."""
    writes = Writes()
    course = begun_with_checks(writes)
    course.frames(UNTIL_LOST, GREEN_UNSEEN)
    assert list(course.guard.lost_robots) == [0]
    writes.asked.clear()
    late_ns = course.now_ns + 300 * MS  # blue, the last robot, is unseen for as long as loses it
    back = replace(PLACES[1], x=PLACES[1].x + 1.0)
    course.guard.check_frame(CameraFrame(999, late_ns, late_ns, (PLACES[0], back)))
    assert course.guard.reason == "blue is not tracked (for 0.30 s)"
    assert writes.asked == [("pose", 1)]


def test_late_steps_abort_in_a_row_only():
    course = running()
    for _ in range(20):
        for _ in range(RULES.limits.late_steps - 1):
            course.guard.record_step(True)
        course.guard.record_step(False)
    assert course.guard.state is GuardState.RUN
    for _ in range(RULES.limits.late_steps):
        course.guard.record_step(True)
    late = "5 control steps in a row were late: is this computer busy?"
    assert course.guard.reason == late


def test_a_controller_that_falls_silent_stops_the_robots():
    course = running()
    while course.guard.state is not GuardState.ABORT:
        course.frame()
        assert course.now_ns < 3000 * MS
    assert course.guard.reason.startswith("5 control steps in a row were late: the controller gave")


def test_a_program_that_slept_does_not_go_on():
    course = running()
    course.now_ns += 2000 * MS
    ruling = course.frame()
    assert ruling.state is GuardState.ABORT
    assert course.guard.reason == (
        "this program stood still for 2.0 s: did the computer sleep, or was the process suspended?"
    )


def test_the_operators_stop_is_an_emergency_and_the_first_reason_stays():
    course = running()
    course.guard.abort("emergency stop by the operator", emergency=True)
    course.guard.abort("something else")
    assert course.guard.emergency
    course.frames(1)
    assert course.guard.reason == "emergency stop by the operator"


class Drive:
    """Green is commanded to drive, at a speed `commanded` [mm/s] and a rate `turning` [rad/s], and
    does `done`: along its heading and across it [mm/s], and around [rad/s]. Blue is to stand.

    Poses are those of a camera of `noise` [mm, and a hundredth of it in rad]; `see` is what it
    makes of green's. Without a `blue` it sees none.
    """

    def __init__(
        self,
        commanded=200.0,
        done=(200.0, 0.0, 0.0),
        turning=0.0,
        noise=0.3,
        blue=PLACES[1],
        **rules,
    ):
        rules = replace(RULES, wheel_radius=40.0, **rules)
        self.course = running(rules, (PLACES[0], blue))
        self.command = (commanded, turning)
        self.done = done
        self.random = random.Random(1)
        self.noise = noise
        self.green = PLACES[0]  # where it truly is
        self.blue = blue

    def go(self, seconds, see=lambda pose: pose):
        """Let robots drive on while the guard lets them; returns the guard."""
        guard = self.course.guard
        for _ in range(round(seconds * FRAMES_A_SECOND)):
            if guard.state is GuardState.RUN:
                self.transmit(*self.command)
                self.move_green()
            else:
                self.transmit(0.0, 0.0)
            green = see(self.noisy(self.green))
            blue = None if self.blue is None else self.noisy(self.blue)
            self.course.frame((green, blue))
            guard.record_direction(self.course.now_ns)
        return guard

    def transmit(self, speed, turning):
        """Tell the guard that green was sent these, and blue to stand."""
        self.course.guard.record_transmission(self.course.now_ns, (speed, 0.0), (turning, 0.0))

    def move_green(self):
        """Let green do for the time of a frame what it does."""
        along, across, around = (rate * FRAME / SECOND for rate in self.done)
        heading = self.green.heading + around
        cos = math.cos(heading)
        sin = math.sin(heading)
        x = self.green.x + along * cos - across * sin
        y = self.green.y + along * sin + across * cos
        self.green = Pose(x, y, heading)

    def noisy(self, pose):
        err = self.random.gauss
        return Pose(
            pose.x + err(0, self.noise),
            pose.y + err(0, self.noise),
            pose.heading + err(0, self.noise / 100),
        )


@pytest.mark.parametrize(
    ("done", "turning", "reason"),
    [
        ((0.0, 0.0, 0.0), 0.0, "green does not move although it is commanded to: check its power"),
        ((-200.0, 0.0, 0.0), 0.0, "green moves backward"),
        ((200.0, 0.0, -1.5), 1.5, "green turns the wrong way"),
        ((200.0, 40.0, 0.0), 0.0, "green moves sideways in a way that no command explains"),
        ((150.0, 0.0, 0.0), 0.0, "green moves along its heading in a way that no command explains"),
        ((200.0, 0.0, 3.0), 1.0, "green moves around in a way that no command explains"),
    ],
)
def test_a_robot_that_does_otherwise_than_commanded_ends_the_run_by_name(done, turning, reason):
    guard = Drive(done=done, turning=turning).go(0.7)
    assert guard.state is GuardState.ABORT
    assert guard.reason.startswith(reason)


def test_a_run_that_goes_on_leaves_out_a_robot_that_does_not_move():
    drive = Drive(done=(0.0, 0.0, 0.0), may_lose_robots=True)
    guard = drive.go(1.5)
    assert guard.state is not GuardState.ABORT
    assert list(guard.lost_robots) == [0]
    assert not drive.course.frame((PLACES[0], drive.blue)).moving[0]


@pytest.mark.parametrize("after", [0.05, 0.15, 0.5])
@pytest.mark.parametrize("frozen", [0.07, 0.2])
def test_a_pose_that_is_frozen_for_a_moment_is_let_pass_at_any_time(frozen, after):
    """Regression: within 0.3 s of the start, when robots may still stand, 70 ms aborted."""
    drive = Drive(commanded=180.0, done=(180.0, 0.0, 0.0))
    drive.go(after)
    held = drive.noisy(drive.green)
    drive.go(frozen, lambda pose: held)
    assert drive.go(1.0).state is GuardState.RUN


AHEAD_X = REACTION_S * 200.0 * math.cos(PLACES[0].heading)
"""How far green comes along x in the time to react [mm]."""


BOX = Shape(np.array([[700.0, 400.0], [900.0, 400.0], [900.0, 700.0], [700.0, 700.0]]), 47.0)


@pytest.mark.parametrize(
    ("obstacles", "edge_x", "about_to"),
    [((), 2000.0, "leave the arena"), ((BOX,), 700.0 - 47.0, "enter an obstacle")],
)
def test_a_robot_is_stopped_before_the_arena_or_an_obstacle(obstacles, edge_x, about_to):
    drive = Drive(obstacles=obstacles)
    assert drive.go(10.0).reason == f"green is about to {about_to}"
    assert drive.green.x == pytest.approx(edge_x - AHEAD_X, abs=3.0)


def test_a_robot_is_stopped_before_it_touches_one_that_was_lost_on_its_way():
    drive = Drive(blue=Pose(900.0, 620.0, 2.0), may_lose_robots=True)
    drive.go(0.1)
    drive.blue = None
    assert drive.go(3.0).reason.startswith("green and blue are too close")


def test_limits_in_millimetres_hold_in_the_units_of_the_spec():
    places = (Pose(50.0, 50.0, 0.3), Pose(50.0, 150.0, -2.0))
    course = running(replace(RULES, mm_per_unit=10.0, speeds=(20.0, 10.0)), places)
    course.frame((Pose(54.0, 50.0, 0.3), places[1]))  # 40 mm in 8 ms
    assert course.guard.refusal_reasons == ("its pose jumped", "")


def test_a_pose_that_is_off_for_some_frames_is_dropped_and_the_run_goes_on():
    drive = Drive()
    drive.go(0.6)
    guard = drive.go(5 / FRAMES_A_SECOND, lambda pose: replace(pose, y=pose.y + 25.0))
    assert guard.refusal_count == 5
    drive.go(1.0)
    assert (guard.state, guard.refusal_count) == (GuardState.RUN, 5)


def with_noise(pose, k):
    """A pose with the noise of frame number k: no two are the same."""
    return replace(pose, x=pose.x + 0.3 * math.sin(k))


def seen_with_noise(frames=60, robots=(0, 1)):
    """A course before its run, these of whose robots a camera with noise has seen."""
    course = Course().pass_preflight()
    for k in range(frames):
        course.frame([with_noise(pose, k * (i in robots)) for i, pose in enumerate(PLACES)])
    return course


def test_a_noisy_camera_that_repeats_its_last_frame_is_frozen_whatever_is_commanded():
    """Regression: robots that may obey 0.3 s late drove for so long after such a frame."""
    course = seen_with_noise().start_run()
    frozen = [with_noise(pose, 59) for pose in PLACES]
    moving = [course.frames(1, frozen).moving for _ in range(8)]
    assert moving[5] == (True, True)  # 48 ms
    assert moving[6] == (False, False)  # 56 ms: as robots that are not tracked
    course.frames(UNTIL_LOST, frozen)
    assert course.guard.state is GuardState.ABORT
    assert course.guard.reason.startswith(
        "green is not tracked: the frame repeats the previous frame"
    )


def test_a_noisy_camera_that_froze_before_the_run_lets_no_robot_drive():
    """Regression: frames that differed last before a run were those of noise, so one that stood
    still as it began had none, and robots drove on it for 0.42 s."""
    course = seen_with_noise()
    frozen = [with_noise(pose, 59) for pose in PLACES]
    course.frames(40, frozen)
    course.start_run()
    assert course.frames(1, frozen).moving == (False, False)


def test_a_noisy_camera_that_freezes_after_the_run_shows_no_robot_at_rest():
    """Regression: a trial counted whose last half second the camera had not seen."""
    course = seen_with_noise().start_run()
    course.guard.end_run()
    frozen = [with_noise(pose, 60) for pose in PLACES]
    course.frame(frozen)
    assert course.accepted.is_fresh == (True, True)
    course.frame(frozen)
    assert course.accepted.is_fresh == (False, False)


@pytest.mark.parametrize(
    ("noisy_frames", "poses_of"),
    [
        pytest.param(0, lambda k: PLACES, id="poses without noise"),
        pytest.param(20, lambda k: PLACES, id="too few frames to tell"),
        pytest.param(60, lambda k: (with_noise(PLACES[0], k), PLACES[1]), id="one robot stands"),
        pytest.param(60, lambda k: [with_noise(p, k // 2) for p in PLACES], id="each frame twice"),
        pytest.param(60, lambda k: [with_noise(p, k) for p in PLACES], id="noise goes on"),
    ],
)
def test_robots_that_stand_are_seen_though_poses_repeat(noisy_frames, poses_of):
    course = seen_with_noise(noisy_frames).start_run()
    for k in range(200, 300):
        ruling = course.frames(1, poses_of(k))
        assert (ruling.state, ruling.moving) == (GuardState.RUN, (True, True))


class Finds(GuardCheck):
    """Stands for a check that finds what it was given: at each tick, or in each frame of a run."""

    def __init__(self, *at_ticks, in_frames=()):
        self._at_ticks = at_ticks
        self._in_frames = in_frames

    def check_places(self, robots):
        yield from self._at_ticks

    def check_frame(self, now_ns, times, poses):
        yield from self._in_frames


class AbortsWhenRead:
    """Stands for limits and a controller's thread that aborts while a ruling is made: just when it
    reads `stale`, the last limit that it reads."""

    def __init__(self):
        self.guard = None

    def __getattr__(self, name):
        if name == "stale" and self.guard is not None:
            self.guard.abort("5 control steps in a row were late")
        return getattr(RULES.limits, name)


def test_an_abort_by_another_thread_while_a_ruling_is_made_is_final():
    """Regression: the ruling entered `run` or `hold` again, and the robots drove on."""
    limits = AbortsWhenRead()
    course = running(replace(RULES, limits=limits))
    limits.guard = course.guard
    ruling = course.tick()
    assert (ruling.state, ruling.moving) == (GuardState.ABORT, (False, False))
    assert course.guard.reason == "5 control steps in a row were late"


@pytest.mark.parametrize(("frames_since", "named"), [(10, True), (130, False)])
@pytest.mark.parametrize("suspect", [None, 0])
def test_the_computer_is_named_first_where_its_own_steps_were_late(frames_since, named, suspect):
    """Regression: on a busy computer robots or the camera were blamed for what late steps did:
    "green is not tracked (0.36 s)"."""
    course = begun_with_checks(Finds(), rules=RULES)
    course.guard.record_step(was_late=True)
    course.frames(frames_since)
    course.guard.record_step(was_late=False)
    if suspect is None:
        course.guard.lose_robot(0, "green is not tracked (0.36 s)")
    else:
        course.guard.abort("green is not tracked (0.36 s)", suspect=suspect)
    course.frame()
    shown = FrameBuffer()
    shown.append(course.accepted)
    course.guard.name_cause(shown)
    assert course.guard.reason == BUSY_BEFORE * named + "green is not tracked (0.36 s)"


@pytest.mark.parametrize("late", [True, False])
def test_the_computer_is_named_first_where_no_frame_came_after_late_steps(late):
    course = begun_with_checks(Finds(), rules=RULES)
    course.frame()
    course.guard.record_step(was_late=late)
    for _ in range(5):
        course.now_ns += SECOND // 10
        course.guard.record_direction(course.now_ns)
        course.tick()
    assert course.guard.reason == BUSY_BEFORE * late + "no new camera frame for 0.50 s"


@pytest.mark.parametrize(("hz", "named"), [(14, True), (19, True), (21, False), (120, False)])
@pytest.mark.parametrize("suspect", [None, 0])
def test_slow_pictures_are_named_where_a_robot_is_blamed(hz, named, suspect):
    """Regression: on a slow computer a cell was not tracked, or moved in a way that no command
    explains: it was asked whether it was pushed, though slow pictures were the cause."""
    course = begun_with_checks(Finds(), rules=RULES)
    shown = FrameBuffer()
    for _ in range(2 * hz):
        course.frame(step=SECOND // hz)
        shown.append(course.accepted)
    if suspect is None:
        course.guard.lose_robot(0, f"green moves{PUSHED_QUESTION}")
    else:
        course.guard.abort(f"green moves{PUSHED_QUESTION}", suspect=suspect)
    course.guard.name_cause(shown)
    slow = f"; only {hz} images per second came, but at least 20 are needed: is this computer busy?"
    assert course.guard.reason == "green moves" + (slow if named else PUSHED_QUESTION)


def test_rest_lets_nothing_move_and_needs_a_new_go():
    course = running()
    course.guard.end_run()
    assert course.frames(1).state is GuardState.READY
    assert not any(course.frames(1).moving)
    course.guard.start_run(course.now_ns)
    assert all(course.frames(1).moving)


COORDINATES = st.floats(-100, 2100)  # up to 100 mm outside
POSES = st.none() | st.builds(Pose, COORDINATES, COORDINATES, st.floats(-math.pi, math.pi))


class GuardMachine(RuleBasedStateMachine):
    """Anything in any order: what must always hold does."""

    @initialize()
    def begin(self):
        self.guard = Guard(RULES)
        self.now = MS
        self.number = 0
        self.bad = 0
        self.exposed = None
        self.seen = [None, None]
        self.ruling = None
        self.aborted = ""

    @rule(a=POSES, b=POSES, age=st.integers(0, 200 * MS), fault=st.sampled_from(["", "", "", "f"]))
    def see(self, a, b, age, fault):
        self.number += 1
        sampled = max(0, self.now - age)
        accepted = self.guard.check_frame(
            CameraFrame(self.number, sampled, self.now, (a, b), fault=fault)
        )
        if self.exposed is not None and sampled <= self.exposed:
            assert accepted is None
            return
        self.exposed = sampled
        for i, pose in enumerate((a, b)):
            if pose is not None:
                self.seen[i] = sampled

    @rule(count=st.integers(1, 20))
    def drive_on(self, count):
        for _ in range(count):
            self.now += FRAME
            self.see(PLACES[0], PLACES[1], 0, "")
            self.guard.record_direction(self.now)
            self.decide(0, None)

    @rule(ms=st.integers(0, 700))
    def time_passes(self, ms):
        self.now += ms * MS

    @rule(bad=st.integers(0, 30), failure=st.sampled_from([None] * 6 + ["gone"]))
    def decide(self, bad, failure):
        self.bad += bad
        self.ruling = self.guard.decide(self.now, self.bad, failure)

    @rule()
    def pass_preflight(self):
        self.guard.pass_preflight()

    @rule()
    def go(self):
        self.guard.start_run(self.now)
        self.ruling = None

    @rule()
    def rest(self):
        self.guard.end_run()
        self.ruling = None

    @rule(missed=st.booleans())
    def step(self, missed):
        self.guard.record_step(missed)

    @invariant()
    def abort_is_for_good(self):
        if not hasattr(self, "guard"):
            return
        if self.aborted:
            assert (self.guard.state, self.guard.reason) == (GuardState.ABORT, self.aborted)
        assert bool(self.guard.reason) == (self.guard.state is GuardState.ABORT)
        self.aborted = self.guard.reason

    @invariant()
    def only_what_is_seen_moves(self):
        ruling = getattr(self, "ruling", None)
        self.ruling = None
        if ruling is None:
            return
        if ruling.state not in (GuardState.RUN, GuardState.HOLD):
            assert not any(ruling.moving)
        assert (ruling.state is GuardState.RUN) <= all(ruling.moving)
        for i, moving in enumerate(ruling.moving):
            if moving:
                assert self.now - self.exposed <= RULES.limits.stale * SECOND
                assert self.exposed - self.seen[i] <= UNTRACKED_STOP_S * SECOND
                pose = ruling.poses[i]
                assert pose is not None


TestGuardMachine = GuardMachine.TestCase
TestGuardMachine.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)


def test_a_pause_forgets_neither_how_seldom_a_robot_is_seen_nor_what_its_wheels_are():
    """Regression: a robot seen for moments only drove on if the robots paused now and then."""
    course = running(replace(RULES, wheel_radius=40.0))
    began = course.now_ns
    fits = []
    while course.guard.state is not GuardState.ABORT and course.now_ns - began < 5 * SECOND:
        course.frames(35, GREEN_UNSEEN)
        course.frames(3)
        if course.guard.state is not GuardState.ABORT:
            course.guard.end_run()
            course.frames(30)
            course.guard.start_run(course.now_ns)
            fits.append(course.guard.drift.block_count)
    assert "green is seen too rarely" in course.guard.reason
    assert course.now_ns - began < 4 * SECOND
    assert fits == sorted(set(fits))  # each stretch adds to the fit


def walk(step_mm, course, frames=40):
    """Green's pose walks on by `step_mm` a frame; return how far it was accepted [mm]."""
    x = PLACES[0].x
    believed = 0.0
    for _ in range(frames):
        x += step_mm
        course.frame((Pose(x, 500.0, 0.3), PLACES[1]))
        course.guard.record_direction(course.now_ns)
        if course.guard.state is GuardState.ABORT:
            break
        believed = course.accepted.poses[0].x - PLACES[0].x
    return believed


@pytest.mark.parametrize("standing", range(0, 30, 3))
def test_a_ghost_that_walks_33_mm_a_frame_is_caught_within_70_mm(standing):
    course = running()
    course.frames(standing + 1)
    assert walk(33.0, course) < 70.0
    assert course.guard.state is GuardState.ABORT
    assert course.guard.reason.startswith("green is not tracked: its pose jumped")


def test_a_heading_that_walks_is_not_believed_for_long():
    rules = replace(RULES, turning=(0.5, 0.5))
    course = running(rules)
    heading = 0.3
    for _ in range(20):
        heading += 0.6
        course.frame((Pose(500.0, 500.0, heading), PLACES[1]))
    assert course.guard.refusal_count >= 18


def test_robots_that_turn_on_the_spot_wait_for_the_next_plan_as_in_a_pause():
    """Regression: every turn at 20 Hz, which lasts 0.55 s, ended the trial."""
    course = running(replace(RULES, silence_ns=500 * MS))
    course.guard.record_direction(course.now_ns, ahead=False)
    began = course.now_ns
    while course.now_ns - began < 990 * MS:
        assert course.frame().moving == (True, True)
    for _ in range(250):
        ruling = course.frame()
    assert (ruling.state, ruling.moving) == (GuardState.HOLD, (False, False))
    for _ in range(5):
        course.guard.record_step(True)
    course.guard.record_direction(course.now_ns)
    assert course.frame().moving == (True, True)
    for _ in range(63):
        course.frame()
    assert "gave no direction for 0.5 s" in course.guard.reason


def test_a_run_that_goes_on_ends_where_a_robot_drives_backward():
    guard = Drive(done=(-200.0, 0.0, 0.0), may_lose_robots=True).go(0.7)
    assert guard.state is GuardState.ABORT


@pytest.mark.long
def test_a_drift_is_the_same_in_every_unit():
    """Green drives an arc, and is seen to do a little more than it is commanded."""

    def worst_drift(mm):
        motions = SimpleNamespace()
        limits = LabLimits(wheel_error=0.12)
        rules = GuardRules(
            ("green",),
            (200.0 / mm,),
            (6.0,),
            RULES.arena,
            limits,
            mm_per_unit=mm,
            wheel_radius=40.0 / mm,
        )
        check = DriftCheck(rules, motions)
        seen_rates = np.array([[210.0 / mm, 3.0 / mm, 1.02]])
        for now_ns in range(0, 20 * SECOND, FRAME):
            t = now_ns / SECOND
            check.record_transmission(now_ns, (200.0 / mm,), (1.0,))
            motions.travelled = seen_rates * t
            check.check_frame(now_ns, [now_ns], (Pose(0.0, 0.0, t),))
        return check.worst_statistic

    assert worst_drift(mm=1.0) == pytest.approx(worst_drift(mm=1000.0))
    assert worst_drift(mm=1.0) != 0.0


def test_a_robot_that_is_carried_to_its_start_is_no_noise_of_the_camera():
    course = seen_with_noise(robots=(0,)).start_run()
    for _ in range(30):
        assert course.frames(1, PLACES).moving == (True, True)


def test_robots_that_stand_as_commanded_may_be_seen_so_to_the_last_bit():
    drive = Drive(commanded=0.0, done=(0.0, 0.0, 0.0), noise=0.0)
    assert drive.go(2.0).state is GuardState.RUN


def test_a_ghost_is_not_believed_after_the_abort_either():
    """Regression: its pose was valid again as soon as the robot could have driven there."""
    drive = Drive()
    walked = [0.0]

    def see(pose):
        walked[0] += 3.0
        return replace(pose, y=pose.y - min(walked[0], 800.0))

    drive.go(0.6)
    guard = drive.go(0.3, see)
    assert guard.state is GuardState.ABORT
    refused = guard.refusal_count
    drive.go(3.0, see)
    assert guard.refusal_count == refused + 3 * FRAMES_A_SECOND
    drive.go(1.0)  # the robot itself: no sensor knows
    assert guard.refusal_count == refused + 4 * FRAMES_A_SECOND


@pytest.mark.parametrize(
    ("finding", "state", "moving", "lost", "warnings"),
    [
        (Warn("one"), GuardState.RUN, (True, True), [], ("one",)),
        (
            Lose(1, "two"),
            GuardState.RUN,
            (True, False),
            [1],
            ("two: the run goes on without this robot",),
        ),
        (Abort("three"), GuardState.ABORT, (False, False), [], ()),
    ],
    ids=["warn", "lose", "abort"],
)
def test_what_a_check_of_a_list_finds_takes_effect_at_once(finding, state, moving, lost, warnings):
    course = begun_with_checks(Finds(finding))
    ruling = course.frame()
    assert (ruling.state, ruling.moving, list(course.guard.lost_robots)) == (state, moving, lost)
    assert course.guard.reason == ("three" if state is GuardState.ABORT else "")
    assert ruling.warnings == warnings


def test_a_body_in_place_of_a_ghost_is_no_ghost():
    """Regression: the poses of the new body were refused for what the old one had done."""
    course = begun_with_checks(Finds(Abort("green drifts", (0,))))
    course.frames(2)
    assert course.guard.refusal_reasons == ("green drifts", "")
    course.guard.lose_robot(0, "green has divided")
    course.guard.replace_robot(0)
    course.frame()
    assert course.accepted.is_fresh == (True, True)


def test_an_abort_for_damaged_frames_passes_on_the_warnings_before_it():
    """Regression: what was warned of since the last tick was lost."""
    course = begun_with_checks(Finds(in_frames=[Warn("green wanders")]), rules=RULES)
    course.damaged = 21
    ruling = course.frame()
    assert course.guard.reason == "21 damaged camera frames within a second"
    assert ruling.warnings == ("green wanders",)


def test_after_an_abort_no_robot_is_lost_any_more():
    """Regression: checks after the one that aborted the run went on losing robots."""
    aborts = Finds(Abort("the first"), Lose(1, "the second"))
    loses = Finds(Lose(0, "the third"))
    course = begun_with_checks(aborts, loses)
    ruling = course.frame()
    assert (course.guard.reason, ruling.warnings) == ("the first", ())
    assert course.guard.lost_robots == {}

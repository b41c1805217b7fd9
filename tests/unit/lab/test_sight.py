"""Tests of the guard with robots that measure their own poses, on a grid and at their own times."""

import math
from dataclasses import replace
from typing import NamedTuple

import pytest
from testkit.labs import fake_lab
from testkit.paths import ROOT
from testkit.trials import experiment

from tetractl.core.clock import SECOND
from tetractl.core.poses import CameraFrame, Pose, Sight
from tetractl.core.setup import Bounds
from tetractl.core.trial import Note
from tetractl.lab.cameras.optitrack.section import OptitrackSection
from tetractl.lab.guard import Guard, GuardState
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.motion_check import POSE_REPEATS, SLACK_S
from tetractl.spec.lab_section import LabLimits
from tetractl.spec.load import load_spec
from tetractl.spec.plants import select_plant

MS = 1_000_000
MAT = Sight(grid_mm=1.36, grid_rad=math.radians(1.0), rate_hz=100.0)
RULES = GuardRules(
    names=("green", "blue"),
    speeds=(120.0, 120.0),
    turning=(6.0, 6.0),
    arena=Bounds(0.0, 0.0, 2000.0, 2000.0),
    limits=LabLimits(),
    wheel_radius=13.0,
    sight=MAT,
)


START_NS = 200 * MS  # when robots begin to move
RADIO_NS = 60 * MS  # from a transmission until robots do what they were sent
FRAME_NS = 10 * MS


def on_grid(value, step):
    return step * round(value / step) if step else value


def test_a_pose_is_off_by_half_a_square_of_the_grid_and_four_deviations_at_most():
    sight = replace(MAT, noise_mm=2.0, noise_rad=0.1)
    assert sight.largest_error_mm == pytest.approx(math.hypot(1.36 / 2, 1.36 / 2) + 8.0)
    assert sight.largest_error_rad == pytest.approx(math.radians(0.5) + 0.4)


class Measured(NamedTuple):
    """A pose as a robot has measured it, and when."""

    time_ns: int
    pose: Pose


class MeasuringRobot:
    """Stands for a robot that measures its own pose every millisecond, on the grid of `sight`, as
    long as it `measures`. The host has each pose `late_ns` after it was measured."""

    def __init__(self, pose, sight, late_ns):
        self.pose = pose
        self.sight = sight
        self.late_ns = late_ns
        self.measures = True
        self.measured = []

    def move(self, speed, turning):
        """Drive for a millisecond."""
        heading = self.pose.heading + turning / 1000
        x = self.pose.x + speed * math.cos(heading) / 1000
        y = self.pose.y + speed * math.sin(heading) / 1000
        self.pose = Pose(x, y, heading)

    def measure(self, now_ns):
        if self.measures:
            x = on_grid(self.pose.x, self.sight.grid_mm)
            y = on_grid(self.pose.y, self.sight.grid_mm)
            heading = on_grid(self.pose.heading, self.sight.grid_rad)
            self.measured.append(Measured(now_ns, Pose(x, y, heading)))

    def newest(self, now_ns):
        """The newest pose that the host has, or the first one until it has any."""
        arrived = [row for row in self.measured if row.time_ns <= now_ns - self.late_ns]
        return arrived[-1] if arrived else self.measured[0]


class Mat:
    """Stands for a mat on which two robots measure their poses, `late` [ns] before each frame, and
    for a host that drives them at `speed` [mm/s] and lets their turning rates swing up to `swing`
    [rad/s]. `held` are the poses of the last frame; while it is `frozen`, frames repeat them.
    """

    def __init__(self, rules=RULES, late=(0, 0), sight=MAT, swing=6.0, speed=100.0):
        self.guard = Guard(rules)
        self.robots = [
            MeasuringRobot(Pose(500.0, 500.0, 0.3), sight, late[0]),
            MeasuringRobot(Pose(1500.0, 500.0, -2.0), sight, late[1]),
        ]
        self.speed = speed
        self.swing = swing
        self.now_ns = 0
        self.held = []
        self.frozen = False
        self.repeats = 0  # number of frames in which green's pose is that of the frame before
        self.ruling = None

    def turning(self, time_ns):
        """The turning rates that are sent at a time [rad/s]."""
        t = time_ns / SECOND
        return [self.swing * math.sin(3 * t), -self.swing * math.cos(2 * t)]

    def go(self, seconds):
        """Drive for a time; returns the guard."""
        for _ in range(round(seconds * 1000)):
            self.now_ns += MS
            turning = self.turning(self.now_ns - RADIO_NS)
            for robot, rate in zip(self.robots, turning, strict=True):
                if self.now_ns > START_NS:
                    robot.move(self.speed, rate)
                robot.measure(self.now_ns)
            if self.now_ns % FRAME_NS == 0:
                self.frame()
        return self.guard

    def frame(self):
        """Show the guard a frame, begin the run at the tenth, and drive on."""
        number = self.now_ns // FRAME_NS
        poses, times_ns = self.shown()
        own_times_ns = times_ns if any(robot.late_ns for robot in self.robots) else ()
        self.guard.check_frame(
            CameraFrame(number, self.now_ns, self.now_ns, poses, exposed_ns=own_times_ns)
        )
        if self.guard.state is GuardState.PREFLIGHT and number == 10:
            self.guard.pass_preflight()
            self.guard.start_run(self.now_ns)
        if self.now_ns > START_NS - RADIO_NS:
            speeds = [self.speed, self.speed]
            self.guard.record_transmission(self.now_ns, speeds, self.turning(self.now_ns))
            self.guard.record_direction(self.now_ns)
        self.ruling = self.guard.decide(self.now_ns)

    def shown(self):
        """The poses of a frame, and their times [ns]."""
        newest = [robot.newest(self.now_ns) for robot in self.robots]
        if not self.frozen:
            green = newest[0].pose
            if self.held and self.held[0].pose == green:
                self.repeats += 1
            self.held = newest
        poses = tuple(row.pose for row in self.held)
        times_ns = tuple(row.time_ns for row in newest)
        return poses, times_ns


@pytest.mark.long
def test_poses_on_a_grid_repeat_and_their_robots_are_not_lost():
    mat = Mat(swing=0.5, speed=60.0)
    guard = mat.go(6.0)
    assert guard.state is GuardState.RUN, guard.reason
    assert guard.refusal_count == 0
    assert mat.repeats > 100


def test_poses_that_stay_for_longer_than_a_step_takes_are_refused():
    mat = Mat(swing=0.5, speed=60.0)
    mat.go(2.0)
    mat.frozen = True
    frozen_ns = mat.now_ns
    while not mat.guard.refusal_reasons[0]:
        mat.go(0.01)
    assert mat.guard.refusal_reasons[0] == POSE_REPEATS
    diagonal_mm = math.sqrt(2) * MAT.grid_mm
    way_mm = diagonal_mm + SLACK_S * RULES.speeds[0]
    step_ms = 1000 * way_mm / (60.0 * (1 - LabLimits().wheel_error))
    assert step_ms - 20 < (mat.now_ns - frozen_ns) / MS < step_ms + 30
    assert mat.go(0.5).state is GuardState.ABORT


def test_a_pose_is_brought_to_the_time_of_its_frame():
    mat = Mat(late=(0, 30 * MS), sight=Sight(), swing=4.0)
    mat.go(3.0)
    green, blue = (robot.pose for robot in mat.robots)
    green_ruled, blue_ruled = mat.ruling.poses

    def off(pose, true_pose):
        return abs(math.remainder(pose.heading - true_pose.heading, math.tau))

    assert off(green_ruled, green) == pytest.approx(0.0, abs=1e-9)
    assert off(mat.held[1].pose, blue) > 0.05
    assert off(blue_ruled, blue) < 0.02


def test_a_robot_whose_own_times_stand_still_is_lost_though_its_pose_is_repeated():
    mat = Mat(late=(0, MS))
    mat.go(2.0)
    mat.robots[1].measures = False
    guard = mat.go(0.4)
    assert guard.state is GuardState.ABORT
    assert guard.reason.startswith("blue is not tracked")


def test_the_spread_is_of_the_noise_and_of_the_grid():
    """A uniform error of a step d has the standard deviation d / sqrt(12)."""
    noisy = Sight(noise_mm=3.0, grid_mm=1.36)
    assert noisy.pose_std[0] == pytest.approx(math.hypot(3.0, 1.36 / math.sqrt(12)))
    assert noisy.has_grid
    assert not Sight(noise_mm=3.0).has_grid


@pytest.mark.parametrize(("declared_hz", "warned"), [(0.0, 0), (120.0, 0), (200.0, 1)])
def test_a_camera_that_is_slower_than_it_says_causes_a_warning(declared_hz, warned):
    setup = replace(experiment().setup, sight=Sight(rate_hz=declared_hz))
    lab = fake_lab(setup)
    lab.plant.open()
    notes = [note for note in lab.plant.events() if isinstance(note, Note)]
    warnings = [note for note in notes if "frames per second instead of 200" in note.text]
    assert len(warnings) == warned


@pytest.mark.long
def test_poses_that_repeat_are_refused_where_nothing_is_said_of_a_grid():
    mat = Mat(replace(RULES, sight=Sight()), swing=0.5, speed=60.0)
    assert mat.go(6.0).refusal_count > 100


@pytest.mark.long
@pytest.mark.parametrize("sight", [Sight(), MAT])
def test_poses_30_ms_apart_do_not_abort_robots_that_turn_at_6_rad_s(sight):
    mat = Mat(replace(RULES, sight=sight), late=(0, 30 * MS), sight=sight)
    guard = mat.go(8.0)
    assert guard.state is GuardState.RUN, guard.reason
    assert guard.refusal_count == 0
    assert mat.ruling.moving == (True, True)


def test_a_pose_that_is_refused_leaves_the_time_of_the_pose_before():
    """Regression: the old pose was logged with the new one's time, which went back later."""
    mat = Mat(late=(0, 30 * MS))
    guard = mat.go(1.0)
    green, blue = mat.held
    now_ns = mat.now_ns + FRAME_NS
    far_outside = Pose(9e3, 9e3, 0.0)
    for i, pose in enumerate((far_outside, None)):
        own_times_ns = (now_ns + i * MS, now_ns)
        frame = CameraFrame(
            number=10**6 + i,
            sampled_ns=max(own_times_ns),
            received_ns=now_ns + MS,
            poses=(pose, blue.pose),
            exposed_ns=own_times_ns,
        )
        assert guard.check_frame(frame).exposed_ns == (green.time_ns, now_ns)


def test_a_pose_that_is_refused_is_compared_once_and_its_robot_disobeys_until_the_next():
    """Frames with another robot's poses repeat it; 60 ms later the run ends for what it did."""
    mat = Mat(late=(0, 30 * MS))
    guard = mat.go(1.0)
    green, blue = (row.pose for row in mat.held)
    sideways = replace(green, y=green.y + 14.0)
    now_ns = mat.now_ns + FRAME_NS

    def show(after_ns):
        """Green's pose of `now_ns` with one of blue that is newer."""
        own_times_ns = (now_ns, now_ns + after_ns)
        frame = CameraFrame(
            number=10**6 + after_ns,
            sampled_ns=max(own_times_ns),
            received_ns=now_ns + 100 * MS,
            poses=(sideways, blue),
            exposed_ns=own_times_ns,
        )
        return guard.check_frame(frame)

    for after_ms in range(3):
        assert not show(after_ms * MS).is_fresh[0]
    assert guard.refusal_count == 1
    fault = guard.refusal_reasons[0]
    show(60 * MS)
    guard.decide(now_ns + 60 * MS)
    assert guard.reason == f"green {fault}"


def test_the_setup_of_another_plant_has_the_sight_of_its_camera(monkeypatch):
    """Regression: the setup of the simulation was kept, and verify computed other decisions."""
    loaded = load_spec(ROOT / "experiments" / "three_m3pi_lab.yaml")
    assert loaded.experiment.setup.sight == Sight()
    monkeypatch.setattr(OptitrackSection, "sight", MAT)
    assert select_plant(loaded, "lab").experiment.setup.sight == MAT

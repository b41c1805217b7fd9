"""What the guard makes of robots that measure their own poses: on a grid, each at its own time."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.labs import fake_lab
from support.paths import ROOT
from support.trials import experiment

from tetractl.core.clock import SECOND
from tetractl.core.commands import Note, Steer
from tetractl.core.poses import CameraFrame, Pose, Sight
from tetractl.core.setup import Bounds
from tetractl.experiment.lab_section import LabLimits
from tetractl.experiment.load import load_spec
from tetractl.experiment.plants import on_plant
from tetractl.lab.cameras.optitrack.section import OptitrackSection
from tetractl.lab.guard import Guard
from tetractl.lab.guard_records import GuardRules, GuardState
from tetractl.lab.motion_check import REPEATS, SLACK_S

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


def on_grid(value, step):
    return step * round(value / step) if step else value


class Mat:
    """Stands for two robots that do what they are sent 60 ms later and measure their own poses,
    `late` [ns] before the frame, on the grid of `sight`. Their turning rates swing up to `swing`
    [rad/s]. They begin to move after 200 ms.
    """

    def __init__(self, rules=RULES, late=(0, 0), sight=MAT, swing=6.0, speed=100.0):
        self.guard = Guard(rules)
        self.late = late
        self.sight = sight
        self.swing = swing
        self.speed = speed
        self.now = 0
        self.number = 0
        self.x = [500.0, 1500.0]
        self.y = [500.0, 500.0]
        self.heading = [0.3, -2.0]
        self.seen: list[list[tuple[int, Pose]]] = [[], []]  # all that each has measured
        self.held: list[tuple[int, Pose]] = []  # what the last frame shows
        self.frozen = False
        self.repeats = 0

    def rates(self, time_ns):
        t = time_ns / SECOND
        return self.speed, [self.swing * math.sin(3 * t), -self.swing * math.cos(2 * t)]

    def go(self, seconds):
        """Drive for a time, with a frame every 10 ms."""
        for _ in range(round(seconds * 1000)):
            self.now += MS
            for i in range(2):
                v, w = self.rates(self.now - 60 * MS)
                if self.now > 200 * MS:
                    self.heading[i] += w[i] / 1000
                    self.x[i] += v * math.cos(self.heading[i]) / 1000
                    self.y[i] += v * math.sin(self.heading[i]) / 1000
                step = self.sight.grid_mm
                turn = self.sight.grid_rad
                place = on_grid(self.x[i], step), on_grid(self.y[i], step)
                self.seen[i].append((self.now, Pose(*place, on_grid(self.heading[i], turn))))
            if self.now % (10 * MS) == 0:
                self.frame()
        return self.guard

    def frame(self):
        poses_at = []
        for measured, late in zip(self.seen, self.late, strict=True):
            arrived = [row for row in measured if row[0] <= self.now - late] or measured[:1]
            poses_at.append(arrived[-1])
        if self.frozen:
            poses_at = [(at, pose) for (at, _), (_, pose) in zip(poses_at, self.held, strict=True)]
        else:
            if self.held and self.held[0][1] == poses_at[0][1]:
                self.repeats += 1
            self.held = poses_at
        self.number += 1
        times = tuple(at for at, _ in poses_at)
        own = times if any(self.late) else ()
        poses = tuple(pose for _, pose in poses_at)
        self.guard.check_frame(CameraFrame(self.number, self.now, self.now, poses, exposed_ns=own))
        if self.guard.state is GuardState.PREFLIGHT and self.number == 10:
            self.guard.pass_preflight()
            self.guard.start_run(self.now)
        if self.now > 140 * MS:
            v, w = self.rates(self.now)
            self.guard.note_transmission(self.now, [v, v], w)
            self.guard.note_direction(self.now)
        self.ruling = self.guard.decide(self.now)


def test_poses_on_a_grid_repeat_and_their_robots_are_not_lost():
    mat = Mat(swing=0.5, speed=60.0)
    guard = mat.go(6.0)
    assert guard.state is GuardState.RUN, guard.reason
    assert guard.refusals == 0
    assert mat.repeats > 100
    blind = Mat(replace(RULES, sight=Sight()), swing=0.5, speed=60.0)
    assert blind.go(6.0).refusals > 100  # a camera that says nothing of its grid


def test_poses_that_stay_for_longer_than_a_step_takes_are_refused():
    mat = Mat(swing=0.5, speed=60.0)
    mat.go(2.0)
    mat.frozen = True
    began = mat.now
    while not mat.guard.refused[0]:
        mat.go(0.01)
    assert mat.guard.refused[0] == REPEATS
    way_mm = math.sqrt(2) * 1.36 + SLACK_S * RULES.speeds[0]
    step_ms = 1000 * way_mm / (60.0 * (1 - LabLimits().wheel_error))
    assert step_ms - 20 < (mat.now - began) / MS < step_ms + 30
    assert mat.go(0.5).state is GuardState.ABORT


@pytest.mark.long
@pytest.mark.parametrize("sight", [Sight(), MAT])
def test_poses_30_ms_apart_do_not_abort_robots_that_turn_at_6_rad_s(sight):
    mat = Mat(replace(RULES, sight=sight), late=(0, 30 * MS), sight=sight)
    guard = mat.go(8.0)
    assert guard.state is GuardState.RUN, guard.reason
    assert guard.refusals == 0
    assert mat.ruling.moving == (True, True)


def test_a_pose_is_brought_to_the_time_of_its_frame():
    mat = Mat(late=(0, 30 * MS), sight=Sight(), swing=4.0)
    mat.go(3.0)
    off = [
        abs(math.remainder(pose.heading - true, math.tau))
        for pose, true in zip(mat.ruling.poses, mat.heading, strict=True)
    ]
    assert off[0] == pytest.approx(0.0, abs=1e-9)
    late = abs(mat.heading[1] - mat.held[1][1].heading)
    assert off[1] < 0.02 < 0.05 < late


def test_a_robot_whose_own_times_stand_still_is_lost_though_its_pose_is_repeated():
    mat = Mat(late=(0, MS))
    mat.go(2.0)
    mat.seen[1] = mat.seen[1][:-1]
    keep = list(mat.seen[1])

    class Stays(list):
        def append(self, item):
            pass

    mat.seen[1] = Stays(keep)
    guard = mat.go(0.4)
    assert guard.state is GuardState.ABORT
    assert guard.reason.startswith("blue is not tracked")


def test_a_pose_that_is_refused_leaves_the_time_of_the_pose_before():
    """Regression: the old pose was logged with the new one's time, which went back later."""
    mat = Mat(late=(0, 30 * MS))
    guard = mat.go(1.0)
    held_ns = mat.held[0][0]
    now = mat.now + 10 * MS
    for i, pose in enumerate((Pose(9e3, 9e3, 0.0), None)):
        own_times = (now + i * MS, now)
        frame = CameraFrame(
            10**6 + i, max(own_times), now + MS, (pose, mat.held[1][1]), exposed_ns=own_times
        )
        assert guard.check_frame(frame).exposed_ns == (held_ns, now)


def test_a_pose_that_is_refused_is_compared_once_and_its_robot_disobeys_until_the_next():
    """Frames with another robot's poses repeat it; 60 ms later the run ends for what it did."""
    mat = Mat(late=(0, 30 * MS))
    guard = mat.go(1.0)
    green, blue = (pose for _, pose in mat.held)
    sideways = replace(green, y=green.y + 14.0)
    now = mat.now + 10 * MS

    def show(after_ns):
        own_times = (now, now + after_ns)
        frame = CameraFrame(
            10**6 + after_ns, max(own_times), now + 100 * MS, (sideways, blue), exposed_ns=own_times
        )
        return guard.check_frame(frame)

    for after_ms in range(3):
        assert not show(after_ms * MS).fresh[0]
    assert guard.refusals == 1
    fault = guard.refused[0]
    show(60 * MS)
    assert guard.decide(now + 60 * MS).reason == f"green {fault}"


def test_the_spread_of_a_grid_is_uniform():
    values = np.random.default_rng(1).uniform(0, 100, 100_000)
    errors = 1.36 * np.round(values / 1.36) - values
    assert MAT.spread[0] == pytest.approx(errors.std(), rel=0.02)
    assert Sight(noise_mm=3.0, grid_mm=1.36).spread[0] == pytest.approx(math.hypot(3, 0.3926), 1e-3)
    assert not Sight(noise_mm=3.0).coarse


@pytest.mark.parametrize(("declared_hz", "warned"), [(0.0, 0), (120.0, 0), (200.0, 1)])
def test_a_camera_that_is_slower_than_it_says_causes_a_warning(declared_hz, warned):
    setup = replace(experiment().setup, sight=Sight(rate_hz=declared_hz))
    lab = fake_lab(setup)
    lab.plant.open()
    texts = [note.text for note in lab.plant.news() if isinstance(note, Note)]
    assert len([text for text in texts if "frames a second come instead of 200" in text]) == warned


def test_a_pose_that_is_later_than_its_frame_stops_the_robots():
    lab = fake_lab(experiment().setup)
    lab.plant.open()
    lab.plant.send(Steer(0.5))
    now = lab.clock.now()
    late = CameraFrame(10**6, now, now, (None,) * 3, exposed_ns=(now, now, now + 1))
    lab.camera.frames = lambda: [late]
    lab.plant.rig.loop.step()
    assert "a pose exposed after the time of its frame" in lab.plant.rig.guard.reason
    assert lab.actuator.sent[-1].direction is None  # a stop


def test_the_setup_of_another_plant_has_the_sight_of_its_camera(monkeypatch):
    """Regression: the setup of the simulation was kept, and verify computed other decisions."""
    loaded = load_spec(ROOT / "experiments" / "three_m3pi_lab.yaml")
    assert loaded.experiment.setup.sight == Sight()
    monkeypatch.setattr(OptitrackSection, "sight", MAT)
    assert on_plant(loaded, "lab").experiment.setup.sight == MAT

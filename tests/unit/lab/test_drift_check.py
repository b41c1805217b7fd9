"""Tests of finding poses that drift away slowly from three driven robots, at 120 Hz."""

import re
import sys
from dataclasses import replace
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

from tetractl.core.clock import SECOND
from tetractl.core.poses import Pose
from tetractl.core.robot_step import RobotStep
from tetractl.core.setup import Bounds
from tetractl.lab.drift_check import DRIFT_TOGETHER, INVERSE_LARGEST, DriftCheck, UnexplainedMotion
from tetractl.lab.guard_rules import GuardRules
from tetractl.spec.lab_section import LabLimits

NAMES = ("green", "blue", "red")
SPEED = 180.0  # [mm/s]
RULES = GuardRules(
    names=NAMES,
    speeds=(SPEED,) * 3,
    turning=(6.0,) * 3,
    arena=Bounds(0.0, 0.0, 2000.0, 2000.0),
    limits=LabLimits(wheel_error=0.12),
    wheel_radius=40.0,
)
FRAME_NS = SECOND // 120
FRAME_S = FRAME_NS / SECOND
RADIO_NS = SECOND // 20  # from a transmission until wheels obey it
NOISE = np.array([0.3, 0.3, 0.004])  # of a usual camera [mm, mm, rad]


def nothing(places, t):
    """A camera that shows robots where they are."""
    return 0.0


class Robots:
    """Stands for three robots whose wheels are up to `share` off and follow turning rates with a
    lag; `astray(t)` [rad/s] is how they turn in addition."""

    def __init__(self, random, share=0.06, lag_s=0.0, astray=lambda t: 0.0):
        self.gains = 1 + random.uniform(-share, share, 3)
        self.lag_s = lag_s
        self.astray = astray
        self.turning = np.zeros(3)
        self.places = np.array([(900.0, 800.0 + 400 * i, 0.0) for i in range(3)])

    def move(self, speed, turning, t):
        """Obey speeds and turning rates (3,) for the time of a frame, which ends t s after the
        start."""
        reached = -np.expm1(-FRAME_S / self.lag_s) if self.lag_s else 1.0
        self.turning = self.turning + (turning - self.turning) * reached
        heading = self.places[:, 2]
        heading += (self.turning * self.gains + self.astray(t)) * FRAME_S
        way = speed * self.gains * FRAME_S
        self.places[:, 0] += way * np.cos(heading)
        self.places[:, 1] += way * np.sin(heading)


class Camera(NamedTuple):
    """Stands for a camera that is `noisy` times as noisy as a usual one. It adds `false_by(places,
    t)` (3, 3) [mm, mm, rad] to the places (3, 3) of robots, t s after the start."""

    random: np.random.Generator
    false_by: object = nothing
    noisy: float = 1.0

    def poses(self, places, t):
        noise = self.noisy * self.random.normal(size=(3, 3)) * NOISE
        rows = places + noise + self.false_by(places, t)
        return [Pose(*row) for row in rows.tolist()]


class Watched:
    """A check, and how far each robot has come in the poses that it was given."""

    def __init__(self):
        self.motions = SimpleNamespace(travelled=np.zeros((3, 3)))
        self.check = DriftCheck(RULES, self.motions)
        self.before = None

    def see(self, now_ns, poses):
        """Return what the check says of these poses, "" at first."""
        before = self.before
        self.before = poses
        if before is None:
            return ""
        pairs = zip(before, poses, strict=True)
        self.motions.travelled += [RobotStep.from_poses(then, pose).motion for then, pose in pairs]
        aborts = self.check.check_frame(now_ns, [now_ns] * len(poses), poses)
        return aborts[0].text if aborts else ""


class Said(NamedTuple):
    """What a check said first, "" if nothing, when [s], and the check."""

    text: str
    after_s: float
    check: DriftCheck


def is_due(now_ns, rate_hz):
    """Whether one of `rate_hz` equal parts of a second has begun since the frame before."""
    return now_ns * rate_hz // SECOND != (now_ns - FRAME_NS) * rate_hz // SECOND


def drifting(
    false_by=nothing,
    seconds=20.0,
    seed=1,
    noisy=1.0,
    most=1.5,
    rate_hz=5,
    rest_ns=None,
    **of_robots,
):
    """Drive robots until the check says something. They are turned by up to `most` [rad/s],
    `rate_hz` times a second, and rest for a moment at `rest_ns`."""
    random = np.random.default_rng(seed)
    robots = Robots(random, **of_robots)
    camera = Camera(random, false_by, noisy)
    watched = Watched()
    turning = np.zeros(3)
    for now_ns in range(FRAME_NS, round(seconds * SECOND), FRAME_NS):
        if now_ns == FRAME_NS or is_due(now_ns, rate_hz):
            turning = random.uniform(-most, most, 3)
            watched.check.record_transmission(now_ns - RADIO_NS, [SPEED] * 3, turning)
        if now_ns == rest_ns:
            watched.check.start()
        t = now_ns / SECOND
        robots.move(SPEED, turning, t)
        text = watched.see(now_ns, camera.poses(robots.places, t))
        if text:
            return Said(text, t, watched.check)
    return Said("", seconds, watched.check)


def test_robots_that_drive_as_commanded_are_let():
    assert drifting().text == ""


def test_robots_before_a_camera_eight_times_as_noisy_as_usual_are_let():
    assert drifting(seconds=4.0, noisy=8.0).text == ""


@pytest.mark.parametrize("seed", range(6))
def test_a_robot_that_lost_packets_turn_for_a_third_of_a_second_is_let(seed):
    """Regression: two packets were lost, and slow wheels followed the next one late: in seven
    blocks, one after another, the robot turned on by more than is counted.
    """

    def turns_on(t):
        return 0.9 if 6.0 <= t < 6.35 else 0.0

    assert drifting(seconds=8.0, seed=seed, astray=turns_on).text == ""


@pytest.mark.parametrize("who", [0, 2])
def test_a_drift_in_steps_is_noticed(who):
    """Regression: each step of 4 mm was clipped as if it were an error of one frame."""

    def steps(places, t):
        off = np.zeros((3, 3))
        count = max(0.0, t - 2.0) // 0.5
        off[who, :2] = np.array([2.4, 3.2]) * count
        return off

    said = drifting(steps, seed=2)
    assert said.text.startswith(f"{NAMES[who]} moves ")
    assert said.after_s < 9.0


@pytest.mark.parametrize("seed", range(6))
def test_one_robot_that_is_pushed_and_turned_is_not_the_cameras(seed):
    """Regression: in some of them "all robots drift together"."""
    angle = np.random.default_rng(100 + seed).uniform(0.0, 6.28)
    push = np.array([20 * np.cos(angle), 20 * np.sin(angle), 0.2])

    def pushed(places, t):
        part = min(1.0, max(0.0, (t - 3.0) / 0.2))
        return np.outer([1.0, 0.0, 0.0], push * part)

    assert drifting(pushed, 9.0, seed).text.startswith("green moves ")


def test_a_picture_that_turns_is_the_cameras():
    def turned(places, t):
        angle = 0.015 * max(0.0, t - 2.0)
        x, y, _ = places.T
        return angle * np.column_stack([-y, x, np.ones(3)])

    assert drifting(turned).text == DRIFT_TOGETHER


def turning_of_straight_robots(seconds, astray):
    """The rates and errors that a check states of robots which are sent straight on but turn by
    `astray` (3,) [rad/s], green and blue while they drive; red is commanded to stand."""
    random = np.random.default_rng(3)
    speed = np.array([SPEED, SPEED, 0.0])
    robots = Robots(random, share=0.0, astray=lambda t: np.where(speed > 0, astray, 0.0))
    watched = Watched()
    for now_ns in range(FRAME_NS, round(seconds * SECOND), FRAME_NS):
        watched.check.record_transmission(now_ns - RADIO_NS, speed, np.zeros(3))
        robots.move(speed, np.zeros(3), now_ns / SECOND)
        rows = robots.places + random.normal(0, 0.003, (3, 3))
        watched.see(now_ns, [Pose(*row) for row in rows.tolist()])
    rates, errors = watched.check.estimate_turning()
    return np.array(rates), np.array(errors)


@pytest.mark.parametrize(("seconds", "error_max"), [(1.0, np.inf), (20.0, 0.02)])
def test_a_trials_turns_are_those_of_its_wheels_whatever_is_expected_of_wheels(seconds, error_max):
    """Their difference is in the standard errors, and a robot that does not drive has no rate."""
    astray = np.array([0.3, -0.5, 0.1])
    rates, errors = turning_of_straight_robots(seconds, astray)
    off = np.abs(rates - astray)
    assert (off[:2] < 3.0 * errors[:2]).all()
    assert errors[0] < error_max
    assert errors[2] == np.inf


@pytest.mark.parametrize(
    ("rate_hz", "limit"), [pytest.param(5, 10.0, marks=pytest.mark.long), (20, 13.0)]
)
def test_robots_with_slow_wheels_that_are_turned_to_and_fro_are_let(rate_hz, limit, monkeypatch):
    """Regression: what is left of a reversal 0.2 s later was taken for a pose that turns; in 14
    trials the statistic reached 13, it reaches 9; if it lasted for 50 ms, 13.3, it reaches 12.2.
    """
    rules = replace(RULES, limits=LabLimits(drift=limit))
    monkeypatch.setattr(sys.modules[__name__], "RULES", rules)
    settings = {"seconds": 60 / rate_hz, "rate_hz": rate_hz, "lag_s": 0.08, "most": 8.0}
    texts = [drifting(seed=seed, **settings).text for seed in range(14)]
    assert texts == [""] * 14


def pushed_by_20_mm(places, t):
    """Green, in a single frame. What is more than an error of a block is carried to the next."""
    off_mm = 20.0 if t > 1.95 else 0.0
    return np.array([[off_mm, 0.0, 0.0], [0.0] * 3, [0.0] * 3])


def test_a_rest_leaves_out_the_ways_that_were_still_to_be_counted():
    """0.05 s after the push, one block has counted a part of it."""
    on_and_on = drifting(pushed_by_20_mm, seconds=3.0)
    with_a_rest = drifting(pushed_by_20_mm, seconds=3.0, rest_ns=240 * FRAME_NS)
    assert on_and_on.text.startswith("green moves along its heading")
    assert with_a_rest.text == ""


class TurningPose:
    """Stands for a camera that shows green's pose turning at 0.2 rad/s, in heading and course: each
    of its ways is shown turned by as much as its heading by then."""

    def __init__(self):
        self.places = None  # of the frame before
        self.off = np.zeros(2)

    def __call__(self, places, t):
        turned = 0.2 * t
        if self.places is not None:
            x, y = (places - self.places)[0, :2]
            cos = np.cos(turned)
            sin = np.sin(turned)
            self.off += (cos * x - sin * y - x, sin * x + cos * y - y)
        self.places = places.copy()
        return np.array([[*self.off, turned], [0.0] * 3, [0.0] * 3])


def test_a_turn_that_one_trial_cannot_distinguish_from_wheels_is_stated():
    said = drifting(TurningPose(), 6.0, share=0.0)
    assert said.text == ""
    turns = said.check.describe_turning()
    rate, error = map(float, re.search(r"green ([+\d.]+) ± ([\d.]+) rad/s$", turns).groups())
    assert rate == pytest.approx(0.2, abs=3 * error + 0.02)
    assert "blue" not in turns


def test_of_a_trial_without_motion_no_turns_are_known():
    assert Watched().check.estimate_turning() == ((), ())


PICTURE = slice(3, 7)


def bare_check(names=("one", "two", "three"), mm=1.0):
    made = object.__new__(DriftCheck)
    made._names = names
    made._mm = mm
    return made


def random_changes(rng, moments, robots, noise):
    """Sums of squares and products of random motions, as after many blocks."""
    columns = rng.normal(size=(moments, robots, 40, 7))
    left = rng.normal(size=(moments, robots, 40))
    squares = np.einsum("gnbp,gnbq->gnpq", columns, columns)
    pulls = np.einsum("gnbp,gnb->gnp", columns, left)
    return UnexplainedMotion(squares, pulls, noise[:, None])


def test_the_shift_of_all_robots_is_that_of_least_squares_weighted_by_their_noise():
    rng = np.random.default_rng(7731)
    noise = np.array([1.0, 3.0, 8.0])
    changes = random_changes(rng, 2, 3, noise)
    shifts, gains = bare_check()._fit_image_motion(changes)
    for g in range(2):
        squares = np.diag(INVERSE_LARGEST[PICTURE])
        pulls = np.zeros(4)
        for n in range(3):
            squares = squares + changes.squares[g, n][PICTURE, PICTURE] / noise[n]
            pulls = pulls + changes.pulls[g, n][PICTURE] / noise[n]
        expected = np.linalg.solve(squares, pulls)
        assert shifts[g] == pytest.approx(expected)
        assert gains[g] == pytest.approx(pulls @ expected)
        # what each robot gains adds up to the reduction, apart from the prior
        of_robots = bare_check()._compute_gains(changes, g, shifts[g])
        of_prior = expected @ np.diag(INVERSE_LARGEST[PICTURE]) @ expected
        assert of_robots.sum() - of_prior == pytest.approx(gains[g])
        for n in range(3):
            pull = changes.pulls[g, n][PICTURE]
            square = changes.squares[g, n][PICTURE, PICTURE]
            reduced = (2 * pull @ expected - expected @ square @ expected) / noise[n]
            assert of_robots[n] == pytest.approx(reduced)


def test_one_robot_alone_gives_no_evidence_of_a_motion_of_the_image():
    changes = random_changes(np.random.default_rng(7732), 2, 1, np.ones(1))
    _, gains = bare_check(("one",))._fit_image_motion(changes)
    assert gains.tolist() == [0, 0]


@pytest.mark.parametrize("mm", [1.0, 1000.0, 0.001])
def test_poses_move_as_a_picture_that_shifts_turns_and_grows(mm):
    """The rates are of x and y [mm/s], of the turn [rad/s] and of the scale [1/s]."""
    pose = Pose(300.0 / mm, -200.0 / mm, 0.7)
    dt_s = 0.04
    rates = np.array([11.0, -7.0, 0.3, 0.05])
    moves = bare_check(mm=mm)._compute_image_motion([pose, pose], np.array([dt_s, 2 * dt_s]))
    place = np.array([300.0, -200.0])
    turned = rates[2] * np.array([-place[1], place[0]])
    moved = (rates[:2] + turned + rates[3] * place) * dt_s
    along = np.array([np.cos(0.7), np.sin(0.7)])
    across = np.array([-np.sin(0.7), np.cos(0.7)])
    assert moves[0] @ rates == pytest.approx([along @ moved, across @ moved])
    assert moves[1] == pytest.approx(2 * moves[0])


@pytest.mark.parametrize("radius", [40.0, 0.0])
def test_errors_of_wheels_delays_drifts_and_pictures_move_robots_by_the_equations_of_the_module(
    radius,
):
    rng = np.random.default_rng(7733)
    dt_s = 0.05
    commands = rng.normal(size=(5, 2)) * (100.0, 2.0)  # by delay: speed and turning rate
    check = bare_check()
    check._radius = radius
    check._find_commands = lambda block: commands
    motion = rng.normal(size=3)
    block = RobotStep(motion, motion, round(dt_s * SECOND), start_pose=Pose(300.0, -200.0, 0.0))
    (row,), (variance,) = check._build_columns([block], motion[None])
    v, w = commands[0]
    assert row[:, 0] == pytest.approx(motion - [v * dt_s, 0.0, w * dt_s])
    s, k, d, b, f, aside = unknowns = rng.normal(size=6)
    weights = rng.normal(size=(3, 2))  # of the later and earlier commands
    later = [weights[:, part] @ (commands[1:4, part] - commands[0, part]) for part in (0, 1)]
    velocity = rng.normal(size=3)
    picture = rng.normal(size=4)
    shift_x, shift_y, turn, growth = picture
    expected = dt_s * np.array(
        [
            s * v + d * w * radius + aside * w + later[0] + velocity[0],
            b * v + f * w + velocity[1],
            (s + k) * w + (d * v / radius if radius else 0.0) + later[1] + velocity[2],
        ]
    )
    expected += dt_s * np.array(
        [shift_x + 200 * turn + 300 * growth, shift_y + 300 * turn - 200 * growth, turn]
    )
    regressors = np.concatenate([unknowns, *weights.T, velocity, picture])
    assert row[:, 1:] @ regressors == pytest.approx(expected)
    spread = np.ptp(commands[:3], axis=0)[[0, 0, 1]] * dt_s
    before = np.abs(commands[3:] - commands[0]).max(axis=0)[[0, 0, 1]] * dt_s
    walk = [1.5**2 * dt_s, 1.5**2 * dt_s, 0.02**2 * dt_s]
    lost = np.array([0.15, 0.0, 0.15])
    assert variance == pytest.approx(walk + (lost * spread) ** 2 + (lost / 5 * before) ** 2)

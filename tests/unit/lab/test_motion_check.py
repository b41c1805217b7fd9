"""Robots, and what is not one, against their commands: frames at 120 Hz, noisy as real ones."""

import math

import numpy as np
import pytest

from tetractl.core.poses import Pose
from tetractl.lab.motion_check import DOES_NOT_MOVE, MotionCheck

pytestmark = pytest.mark.slow

A, SPEED, RADIUS = 6.0, 180.0, 40.0  # rad/s, mm/s, mm
FRAME, SEND, WATCHDOG = 8_333_333, 25_000_000, 250_000_000  # ns
WIDE, CHATTER = (0.4, 2.5, -2.0, 1.0, 3.0), (1.2, -1.2)
NOISE_MM, NOISE_RAD = 0.3, 0.004


def drive(
    delay=0.05,
    lag=0.04,
    gains=(1.0, 1.0),
    lost=0.05,
    directions=WIDE,
    seed=1,
    shown=lambda t, x, y, heading: (x, y, heading),
    seconds=4.0,
    stuck=(9.0, 9.0),
    stop=9.0,
    noise=1.0,
):
    """Drive a robot of two wheels `gains` off under the law a sin(u - heading).

    The direction changes every 0.2 s; `shown` is what the camera makes of its pose t s after the
    first second. The wheels are `stuck` from some second on, and it is commanded to `stop`.

    Returns what the check says, and when, after the first second [s].
    """
    check, random = MotionCheck([SPEED], RADIUS, 2.0), np.random.default_rng(seed)
    x, y, heading, wheels = 900.0, 800.0, 0.0, np.zeros(2)
    queue, next_ns, heard, acting, before = [], 0, -WATCHDOG, np.zeros(2), None
    for now in range(FRAME, round(seconds * 1e9), FRAME):
        t, dt = now / 1e9 - 1.0, FRAME / 1e9
        while next_ns <= now:
            u = directions[next_ns // 200_000_000 % len(directions)]
            seen = before.heading if before else 0.0
            v, w = (0.0, 0.0) if t > stop else (SPEED, A * math.sin(u - seen))
            check.sent(next_ns, [v], [w], 0.12)
            if random.random() >= lost:
                queue.append((next_ns + round(delay * 1e9), [v - w * RADIUS, v + w * RADIUS]))
            next_ns += SEND
        while queue and queue[0][0] <= now:
            heard, acting = queue[0][0], np.array(queue.pop(0)[1])
        wanted = acting * gains if now - heard < WATCHDOG else np.zeros(2)
        wheels = wanted + (wheels - wanted) * math.exp(-dt / lag)
        wheels = wheels * [t < each for each in stuck]
        speed, turning = wheels.mean(), (wheels[1] - wheels[0]) / (2 * RADIUS)
        heading += turning * dt
        x += speed * math.cos(heading - turning * dt / 2) * dt
        y += speed * math.sin(heading - turning * dt / 2) * dt
        pose = Pose(*(shown(t, x, y, heading) if t > 0 else (x, y, heading)))
        errs = random.normal(0, noise, 3) * (NOISE_MM, NOISE_MM, NOISE_RAD)
        pose = Pose(pose.x + errs[0], pose.y + errs[1], pose.heading + errs[2])
        check.take_frame((now,))
        if before and (said := check.take_pose(0, before, pose)):
            return said, t
        before = pose
    return "", math.inf


@pytest.mark.parametrize("delay", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("gains", [(1.1, 1.1), (0.9, 0.9), (0.9, 1.1)])
@pytest.mark.parametrize("directions", [WIDE, CHATTER, (1.2,)])
def test_a_robot_that_moves_as_commanded_agrees(delay, gains, directions):
    for seed in range(2):
        assert drive(delay, gains=gains, directions=directions, seed=seed) == ("", math.inf)


def test_one_that_is_stopped_or_loses_many_packets_agrees_too():
    for seed in range(3):
        assert drive(lost=0.3, seed=seed, directions=(1.2, 1.5, 1.0))[0] == ""
        assert drive(stop=1.0, seed=seed)[0] == ""


def walk(speed, course):
    """A ghost that leaves its robot [m/s] by a course against its heading [rad]."""

    def shown(t, x, y, heading):
        way = 1000 * speed * t
        return x + way * math.cos(heading + course), y + way * math.sin(heading + course), heading

    return shown


@pytest.mark.parametrize("speed", [0.05, 0.18, 0.4])
@pytest.mark.parametrize("course", [0.0, math.pi, math.pi / 2, -math.pi / 2])
def test_a_ghost_is_noticed_within_30_mm_or_0_3_s(speed, course):
    for seed in range(2):
        said, after_s = drive(shown=walk(speed, course), seed=seed, directions=(0.3, 0.6))
        assert said
        assert after_s < 0.3 or 1000 * speed * after_s < 30.0


@pytest.mark.parametrize("turning", [1.25, -1.25, 3.0, -5.0])
def test_a_heading_that_turns_by_itself_is_noticed_within_half_a_second(turning):
    said, after_s = drive(shown=lambda t, x, y, heading: (x, y, heading + turning * t))
    assert said.startswith(("moves", "turns"))
    assert after_s < 0.5


@pytest.mark.parametrize("stuck", [(0.0, 0.0), (0.0, 9.0), (9.0, 0.0)])
def test_a_robot_of_stuck_wheels_is_noticed_within_0_3_s(stuck):
    said, after_s = drive(stuck=stuck)
    assert after_s < 0.3
    assert said == DOES_NOT_MOVE or 9.0 in stuck


@pytest.mark.parametrize(
    ("shown", "within_s"),
    [
        (walk(0.05, 0.3), 0.3),  # 15 mm
        (lambda t, x, y, heading: (x, y, heading + 1.25 * t), 0.2),
    ],
    ids=["moves", "turns"],
)
def test_a_standing_robot_that_is_seen_to_move_or_turn_is_noticed(shown, within_s):
    said, after_s = drive(shown=shown, stop=-0.5, directions=(0.0,))
    assert said.startswith(("moves", "turns"))
    assert after_s < within_s


def test_a_robot_that_hears_nothing_may_stop_by_its_watchdog():
    check, before = MotionCheck([SPEED], RADIUS, 2.0), None
    for k in range(20):
        check.sent(k * SEND, [SPEED], [0.0], 0.12)
    for now in range(19 * SEND, 2_000_000_000, FRAME):
        x = SPEED * min(now, 19 * SEND + WATCHDOG) / 1e9
        check.take_frame((now,))
        assert before is None or check.take_pose(0, before, Pose(x, 0, 0)) == ""
        before = Pose(x, 0, 0)


def test_a_gap_in_the_frames_is_bridged():
    check = MotionCheck([SPEED], RADIUS, 2.0)
    for step in range(60):
        check.sent(step * SEND, [SPEED], [3.0], 0.12)
    poses = [
        Pose(60 * math.sin(3 * t), 60 * (1 - math.cos(3 * t)), 3 * t) for t in (0.5, 0.51, 0.8)
    ]
    said = []
    for before, pose, t in zip([poses[0], *poses], poses, (0.5, 0.51, 0.8), strict=False):
        check.take_frame((round(t * 1e9),))
        said.append(check.take_pose(0, before, pose))
    assert said == ["", "", ""]


@pytest.mark.parametrize(("radius", "said"), [(RADIUS, "drive"), (0.0, "field's sign")])
def test_a_cell_has_no_drive(radius, said):
    check, before = MotionCheck([SPEED], radius, 2.0), None
    for now in range(FRAME, 2_000_000_000, FRAME):
        check.sent(now, [SPEED], [2.0], 0.12)
        pose = Pose(900 + 180e-9 * now, 800.0, -2e-9 * now)
        check.take_frame((now,))
        if before and (found := check.take_pose(0, before, pose)):
            break
        before = pose
    assert said in found

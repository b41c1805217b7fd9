"""Robots, and what is not one, against their commands: frames at 120 Hz, noisy as real ones."""

import math

import numpy as np
import pytest

from tetractl.core.poses import Pose
from tetractl.lab.motion_check import DOES_NOT_MOVE, MotionCheck

pytestmark = pytest.mark.slow

A = 6.0  # greatest turning rate [rad/s]
SPEED = 180.0  # mm/s
RADIUS = 40.0  # distance of a wheel from the robot's centre [mm]
FRAME = 8_333_333  # time between two frames [ns]
SEND = 25_000_000  # time between two transmissions [ns]
WATCHDOG = 250_000_000  # time without a packet after which wheels stop [ns]
WIDE = (0.4, 2.5, -2.0, 1.0, 3.0)  # directions that differ much [rad]
CHATTER = (1.2, -1.2)
NOISE_MM = 0.3
NOISE_RAD = 0.004
NEVER_S = 9.0  # after the end of every drive


class WheeledRobot:
    """Stands for a robot whose wheels are `gains` off: it obeys a packet `delay` s after it was
    sent, with a lag, and stops by its watchdog. A wheel is `stuck` from some second on."""

    def __init__(self, delay, lag, gains, stuck):
        self.delay_ns = round(delay * 1e9)
        self.lag = lag
        self.gains = np.array(gains)
        self.stuck = np.array(stuck)
        self.x = 900.0
        self.y = 800.0
        self.heading = 0.0
        self.wheels = np.zeros(2)  # mm/s
        self.packets = []  # on their way: when each is obeyed, and its wheels' speeds
        self.obeyed_ns = -WATCHDOG
        self.obeyed = np.zeros(2)

    def send(self, now_ns, v, w):
        self.packets.append((now_ns + self.delay_ns, np.array([v - w * RADIUS, v + w * RADIUS])))

    def move(self, now_ns, t, dt):
        while self.packets and self.packets[0][0] <= now_ns:
            self.obeyed_ns, self.obeyed = self.packets.pop(0)
        stopped = now_ns - self.obeyed_ns >= WATCHDOG
        wanted = np.zeros(2) if stopped else self.obeyed * self.gains
        self.wheels = wanted + (self.wheels - wanted) * math.exp(-dt / self.lag)
        self.wheels[t >= self.stuck] = 0.0
        speed = self.wheels.mean()
        turning = (self.wheels[1] - self.wheels[0]) / (2 * RADIUS)
        self.heading += turning * dt
        middle = self.heading - turning * dt / 2
        self.x += speed * math.cos(middle) * dt
        self.y += speed * math.sin(middle) * dt


def as_it_is(t, x, y, heading):
    return x, y, heading


def drive(
    delay=0.05,
    lag=0.04,
    gains=(1.0, 1.0),
    lost=0.05,
    directions=WIDE,
    seed=1,
    shown=as_it_is,
    seconds=4.0,
    stuck=(NEVER_S, NEVER_S),
    stop=NEVER_S,
    noise=1.0,
):
    """Drive a robot under the law a sin(u - heading), with a share of the packets `lost`.

    The direction changes every 0.2 s; `shown` is what the camera makes of its pose t s after the
    first second. It is commanded to `stop` at some t.

    Returns what the check says, and when, after the first second [s].
    """
    check = MotionCheck([SPEED], RADIUS, 2.0)
    random = np.random.default_rng(seed)
    robot = WheeledRobot(delay, lag, gains, stuck)
    next_ns = 0
    before = None
    for now in range(FRAME, round(seconds * 1e9), FRAME):
        t = now / 1e9 - 1.0
        while next_ns <= now:
            u = directions[next_ns // 200_000_000 % len(directions)]
            heading = before.heading if before else 0.0
            v, w = (0.0, 0.0) if t > stop else (SPEED, A * math.sin(u - heading))
            check.sent(next_ns, [v], [w], 0.12)
            if random.random() >= lost:
                robot.send(next_ns, v, w)
            next_ns += SEND
        robot.move(now, t, FRAME / 1e9)
        show = shown if t > 0 else as_it_is
        x, y, heading = show(t, robot.x, robot.y, robot.heading)
        dx, dy, turned = random.normal(0, noise, 3) * (NOISE_MM, NOISE_MM, NOISE_RAD)
        pose = Pose(x + dx, y + dy, heading + turned)
        check.take_frame((now,))
        fault = check.take_pose(0, before, pose) if before else ""
        if fault:
            return fault, t
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
        fault, after_s = drive(shown=walk(speed, course), seed=seed, directions=(0.3, 0.6))
        assert fault
        assert after_s < 0.3 or 1000 * speed * after_s < 30.0


@pytest.mark.parametrize("turning", [1.25, -1.25, 3.0, -5.0])
def test_a_heading_that_turns_by_itself_is_noticed_within_half_a_second(turning):
    fault, after_s = drive(shown=lambda t, x, y, heading: (x, y, heading + turning * t))
    assert fault.startswith(("moves", "turns"))
    assert after_s < 0.5


@pytest.mark.parametrize("stuck", [(0.0, 0.0), (0.0, NEVER_S), (NEVER_S, 0.0)])
def test_a_robot_of_stuck_wheels_is_noticed_within_0_3_s(stuck):
    fault, after_s = drive(stuck=stuck)
    assert after_s < 0.3
    assert fault == DOES_NOT_MOVE or NEVER_S in stuck


def test_a_robot_that_is_to_turn_on_the_spot_and_stands_does_not_move():
    """Regression: it was said to move around as no command does."""
    check = MotionCheck([SPEED], RADIUS, 2.0)
    for k in range(40):
        check.sent(k * SEND, [0.0], [A], 0.12)
    stands = Pose(900.0, 800.0, 0.0)
    faults = []
    for now in range(20 * SEND, 40 * SEND, FRAME):
        check.take_frame((now,))
        faults.append(check.take_pose(0, stands, stands))
    assert set(faults) == {"", DOES_NOT_MOVE}


@pytest.mark.parametrize(
    ("shown", "within_s"),
    [
        (walk(0.05, 0.3), 0.3),  # 15 mm
        (lambda t, x, y, heading: (x, y, heading + 1.25 * t), 0.2),
    ],
    ids=["moves", "turns"],
)
def test_a_standing_robot_that_is_seen_to_move_or_turn_is_noticed(shown, within_s):
    fault, after_s = drive(shown=shown, stop=-0.5, directions=(0.0,))
    assert fault.startswith(("moves", "turns"))
    assert after_s < within_s


def test_a_robot_that_hears_nothing_may_stop_by_its_watchdog():
    check = MotionCheck([SPEED], RADIUS, 2.0)
    before = None
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
    faults = []
    for before, pose, t in zip([poses[0], *poses], poses, (0.5, 0.51, 0.8), strict=False):
        check.take_frame((round(t * 1e9),))
        faults.append(check.take_pose(0, before, pose))
    assert faults == ["", "", ""]


@pytest.mark.parametrize(("radius", "part"), [(RADIUS, "drive"), (0.0, "field's sign")])
def test_a_cell_has_no_drive(radius, part):
    """It is seen to turn to the right while it is commanded to turn to the left."""
    check = MotionCheck([SPEED], radius, 2.0)
    before = None
    fault = ""
    for now in range(FRAME, 2_000_000_000, FRAME):
        check.sent(now, [SPEED], [2.0], 0.12)
        pose = Pose(900 + SPEED * 1e-9 * now, 800.0, -2e-9 * now)
        check.take_frame((now,))
        fault = check.take_pose(0, before, pose) if before else ""
        if fault:
            break
        before = pose
    assert part in fault

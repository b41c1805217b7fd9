"""Tests of naming the cause of an abort: robot, camera, radio, or two swapped numbers."""

from types import SimpleNamespace

import numpy as np
import pytest

from tetractl.core.clock import SECOND
from tetractl.core.poses import CameraFrame, Pose
from tetractl.core.robot_step import RobotStep
from tetractl.core.setup import Bounds
from tetractl.lab.abort_cause import (
    CAMERA_MOVED,
    MOTION_ERROR,
    NUMBERS_SWAPPED,
    POSE_DIFFERENCE_STD,
    RADIO_SLOW,
    RECENT_NS,
    AbortCause,
    compute_squares,
)
from tetractl.lab.drift_check import DriftCheck
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.motion_check import DOES_NOT_MOVE, MOVES_UNEXPLAINED, TURNS_WRONG_WAY
from tetractl.spec.lab_section import LabLimits

NAMES = ("green", "blue", "red")
PAIR = NAMES[:2]
SPEEDS = (180.0, 200.0, 150.0)  # [mm/s]
TURNING = (6.0, 4.0, 3.0)  # [rad/s]
ARENA = Bounds(0.0, 0.0, 2000.0, 2000.0)
OTHERWISE = MOVES_UNEXPLAINED.format("around")
FRAME_NS = SECOND // 120
FRAME_S = FRAME_NS / SECOND
SEND_NS = SECOND // 40
STEP_NS = SECOND // 5
END_NS = 3 * SECOND
NOISE = np.array([0.3, 0.3, 0.004])  # of a pose [mm, mm, rad]
FAULT_S = 0.3
"""Time before the end when the fault begins; wheels are learnt until then."""
EXCHANGE_S = 0.6
"""The same where robots have exchanged their numbers."""


def nowhere(i, place, t):
    """A camera that shows a robot where it is."""
    return np.zeros(3)


def seconds_left(now_ns):
    """The time until the end [s]."""
    return (END_NS - now_ns) / SECOND


def begins(now_ns, every_ns):
    """Whether one of these spans of time has begun since the frame before."""
    return now_ns // every_ns != (now_ns - FRAME_NS) // every_ns


class Robots:
    """Stands for robots whose wheels are up to 8 % off and which obey `delay_s` after a packet was
    sent. In the last EXCHANGE_S robot i does what robot `obeys[i]` is commanded."""

    def __init__(self, random, count, delay_s, obeys=None):
        self.gains = 1 + random.uniform(-0.08, 0.08, (2, count))
        self.places = np.array([(900.0, 800.0 + 400 * i, 0.0) for i in range(count)])
        self.delay_s = delay_s
        self.obeys = list(range(count)) if obeys is None else obeys
        self.packets = []  # on their way: when each is obeyed, speeds and turning rates (2, N)
        self.rates = np.zeros((2, count))

    def send(self, now_ns, speeds, turning):
        self.packets.append((now_ns + self.delay_s * SECOND, np.array([speeds, turning])))

    def move(self, now_ns):
        """Obey the packets that have come, for the time of a frame."""
        everyone = list(range(len(self.places)))
        while self.packets and self.packets[0][0] <= now_ns:
            _, rates = self.packets.pop(0)
            whose = self.obeys if seconds_left(now_ns) < EXCHANGE_S else everyone
            self.rates = rates[:, whose] * self.gains
        speeds, turning = self.rates
        heading = self.places[:, 2]
        heading += turning * FRAME_S
        self.places[:, 0] += speeds * np.cos(heading) * FRAME_S
        self.places[:, 1] += speeds * np.sin(heading) * FRAME_S


class Camera:
    """Stands for a camera that adds noise and `false_by(i, place, t)` (3,) to the true place (3,)
    of robot i, t s before the end. Robot i is seen as it was `ages[i]` frames before the newest."""

    def __init__(self, random, false_by, ages):
        self.random = random
        self.false_by = false_by
        self.ages = ages
        self.pictures = []  # places as they were seen in each frame

    def poses(self, places, now_ns):
        off = [self.false_by(i, place, seconds_left(now_ns)) for i, place in enumerate(places)]
        noise = self.random.normal(size=places.shape) * NOISE
        self.pictures.append((places + noise + off).tolist())
        newest = len(self.pictures) - 1
        rows = [self.pictures[max(newest - age, 0)][i] for i, age in enumerate(self.ages)]
        return tuple(Pose(*row) for row in rows)


def accused(
    false_by=nowhere,
    delay_s=0.06,
    seed=1,
    names=NAMES,
    suspect=0,
    ages=(0, 0, 0),
    obeys=None,
    reason=OTHERWISE,
    usual_s=0.3,
):
    """What is named at the end. Robots of these names drive under one direction, which changes
    every STEP_NS, and the guard suspects one of them for this reason."""
    random = np.random.default_rng(seed)
    count = len(names)
    motions = SimpleNamespace(travelled=np.zeros((count, 3)))
    limits = LabLimits(wheel_error=0.12, delay=usual_s)
    rules = GuardRules(names, SPEEDS[:count], TURNING[:count], ARENA, limits, wheel_radius=40.0)
    drift = DriftCheck(rules, motions)
    frames = []
    robots = Robots(random, count, delay_s, obeys)
    camera = Camera(random, false_by, ages[:count])
    learnt_until_s = FAULT_S if obeys is None else EXCHANGE_S
    direction = 0.0
    before = None
    for now_ns in range(FRAME_NS, END_NS, FRAME_NS):
        if begins(now_ns, STEP_NS):
            direction = random.uniform(-2, 2)
        if begins(now_ns, SEND_NS):
            turning = np.array(TURNING[:count]) * np.sin(direction - robots.places[:, 2])
            drift.record_transmission(now_ns, SPEEDS[:count], turning)
            robots.send(now_ns, SPEEDS[:count], turning)
        robots.move(now_ns)
        poses = camera.poses(robots.places, now_ns)
        times_ns = tuple(now_ns - age * FRAME_NS for age in camera.ages)
        frames.append(CameraFrame(len(frames), now_ns, now_ns, poses, exposed_ns=times_ns))
        if before is not None and seconds_left(now_ns) > learnt_until_s:
            pairs = zip(before, poses, strict=True)
            motions.travelled += [RobotStep.from_poses(*pair).motion for pair in pairs]
            drift.check_frame(now_ns, times_ns, poses)
        before = poses
    shown = [frame for frame in frames if now_ns - frame.sampled_ns <= RECENT_NS]
    return AbortCause(rules, drift, shown).explain(suspect, reason)


def pushed(who):
    """A displacement of some robots by 20 mm, 0.2 s before the end."""
    off_mm = np.array([12.0, 16.0, 0.0])

    def false_by(i, place, t):
        return off_mm if t < 0.2 and i in who else np.zeros(3)

    return false_by


@pytest.mark.parametrize("seed", range(3))
def test_one_robot_that_was_pushed_or_is_shown_elsewhere_is_named_itself(seed):
    assert [accused(pushed([i]), seed=seed, suspect=i) for i in range(3)] == [""] * 3
    assert accused(pushed([1]), seed=seed, names=PAIR, suspect=1) == ""


@pytest.mark.parametrize("seed", [2, 9, 11, 13])
def test_a_robot_that_is_carried_is_not_the_radios(seed):
    """Regression: "is the radio slow?", where commands act 0.25 s after they are sent."""

    def carried(i, place, t):
        return np.array([60.0, 80.0, 0.0]) * (i == 0) * max(0.0, 0.1 - t)

    assert accused(carried, delay_s=0.25, seed=seed) == ""


@pytest.mark.parametrize("seed", range(3))
def test_a_moved_origin_is_the_cameras(seed):
    """Regression: "does the camera track another body as this robot?", 6 of 6."""
    assert accused(pushed([0, 1, 2]), seed=seed) == CAMERA_MOVED
    assert accused(pushed([0, 1]), seed=seed, names=PAIR) == CAMERA_MOVED


def test_a_camera_that_turns_is_the_cameras():
    """Regression: "does not move although it is commanded to: check its power"."""

    def turned(i, place, t):
        angle = 0.1 * max(0.0, 0.3 - t)
        return angle * np.array([-place[1], place[0], 1.0])

    assert accused(turned) == CAMERA_MOVED


@pytest.mark.parametrize("seed", range(3))
def test_a_slow_radio_is_named_with_its_delay(seed):
    """Regression: "does the camera track another body as this robot?"."""
    assert accused(delay_s=0.5, seed=seed) == RADIO_SLOW.format(0.5)


@pytest.mark.parametrize("usual_s", [0.6, 1.0])
def test_a_delay_that_the_spec_allows_is_not_called_slow(usual_s):
    """Regression: only the motion check knew of `limits.delay`."""
    assert "radio" not in accused(delay_s=0.5, usual_s=usual_s)


@pytest.mark.parametrize("seed", [0, 3, 4])  # in which they are commanded differently
@pytest.mark.parametrize(("first", "second"), [(0, 1), (0, 2), (1, 2)])
def test_two_robots_that_do_what_the_other_is_commanded_are_named_together(seed, first, second):
    obeys = [0, 1, 2]
    obeys[first] = second
    obeys[second] = first
    text = NUMBERS_SWAPPED.format(NAMES[first], NAMES[second])
    assert accused(obeys=obeys, seed=seed, suspect=first) == text
    assert accused(obeys=obeys, seed=seed, suspect=second) == text


def test_the_two_of_two_robots_are_named_together_if_they_have_exchanged_numbers():
    assert accused(obeys=[1, 0], names=PAIR, seed=4) == NUMBERS_SWAPPED.format(*PAIR)


def test_numbers_are_not_asked_for_if_the_reason_says_what_is_wrong_with_the_robot():
    text = NUMBERS_SWAPPED.format(*PAIR)
    assert accused(obeys=[1, 0, 2], seed=3) == text
    assert accused(obeys=[1, 0, 2], seed=3, reason=TURNS_WRONG_WAY) != text


@pytest.mark.parametrize("seed", range(3))
def test_a_robot_that_was_pushed_sideways_is_not_taken_for_another(seed):
    """One alone that moves as another is commanded is not named: a push may look so."""

    def slid(i, place, t):
        if i != 1:
            return np.zeros(3)
        across = np.array([-np.sin(place[2]), np.cos(place[2]), 0.0])
        return 200.0 * max(0.0, 0.1 - t) * across

    assert accused(slid, seed=seed, suspect=1) == ""


def test_nothing_is_named_but_the_robot_if_it_drives_alone():
    assert accused(pushed([0]), names=NAMES[:1]) == ""


def test_robots_that_all_stand_are_named_themselves():
    """Regression: a radio that fell silent was named as slow, or as a camera that moves."""
    last_places = {}

    def stand(i, place, t):
        if t > 0.2:
            last_places[i] = place.copy()
        return last_places[i] - place

    assert accused(stand, reason=DOES_NOT_MOVE) == ""


@pytest.mark.parametrize("seed", range(3))
def test_robots_that_are_seen_at_times_of_their_own_are_named_as_others(seed):
    ages = (0, 6, 12)  # up to 0.1 s
    assert accused(pushed([0]), seed=seed, ages=ages) == ""
    assert accused(pushed([0, 1, 2]), seed=seed, ages=ages) == CAMERA_MOVED
    assert accused(delay_s=0.5, seed=seed, ages=ages) == RADIO_SLOW.format(0.5)


def test_a_robot_that_moves_as_commanded_leaves_no_square():
    sent = np.array([[[10.0, 5.0], [0.1, -0.2]], [[8.0, 5.0], [0.3, 0.4]]])  # (T, 2, n)
    then = np.array([[100.0, 50.0, 0.7], [0.0, 0.0, -3.0]])
    now = then.copy()
    for ways, turns in sent:
        course = now[:, 2] + turns / 2
        now = now + np.column_stack([ways * np.cos(course), ways * np.sin(course), turns])
    assert compute_squares(then, now, sent) == pytest.approx(np.zeros(2), abs=1e-12)
    whole_turn = now + np.array([0.0, 0.0, 2 * np.pi])
    assert compute_squares(then, whole_turn, sent) == pytest.approx(np.zeros(2), abs=1e-12)


@pytest.mark.parametrize(("off", "size"), [(0, 18.0), (1, 18.0), (2, 0.4)])
def test_a_deviation_counts_by_its_direction_and_by_what_was_commanded(off, size):
    sent = np.array([[[10.0], [0.1]], [[8.0], [-0.3]]])
    heading = 0.7 + 0.1 - 0.3
    now = np.array([[0.0, 0.0, 0.7]])
    for ways, turns in sent:
        course = now[:, 2] + turns / 2
        now = now + np.column_stack([ways * np.cos(course), ways * np.sin(course), turns])
    deviation = 0.5
    shift = {
        0: (np.cos(heading) * deviation, np.sin(heading) * deviation, 0.0),
        1: (-np.sin(heading) * deviation, np.cos(heading) * deviation, 0.0),
        2: (0.0, 0.0, deviation),
    }[off]
    expected = (deviation / (POSE_DIFFERENCE_STD[off] + MOTION_ERROR[off] * size)) ** 2
    squares = compute_squares(np.array([[0.0, 0.0, 0.7]]), now + np.array(shift), sent)
    assert squares == pytest.approx([expected])

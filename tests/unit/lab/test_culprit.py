"""Which of one robot, the camera, the radio and two numbers is named, of robots seen at 120 Hz."""

import numpy as np
import pytest

from tetractl.core.clock import SECOND
from tetractl.core.poses import Pose
from tetractl.lab.culprit import CAMERA, RADIO, SWAPPED, Culprit
from tetractl.lab.drift_check import DriftCheck
from tetractl.lab.motion_check import ANOTHER, DOES_NOT_MOVE, WRONG_WAY, motion

NAMES = ("green", "blue", "red")
SPEEDS = (180.0, 200.0, 150.0)
TURNING = (6.0, 4.0, 3.0)
OTHERWISE = ANOTHER.format("around")
FRAME_NS = SECOND // 120
SEND_NS = SECOND // 40
NONE = np.zeros(3)


def accused(
    shown=lambda i, place, t: NONE,
    delay_s=0.06,
    seed=1,
    who=NAMES,
    suspect=0,
    skew=(0, 0, 0),
    obeys=None,
    reason=OTHERWISE,
):
    """What is named after 3 s if the camera adds `shown` (3,) to a robot's true place (3,), t s
    before the end; wheels are up to 8 % off. Robots are seen `skew` frames before the newest. In
    the last 0.6 s robot i does what robot `obeys[i]` is commanded, by default its own.
    """
    random = np.random.default_rng(seed)
    n = len(who)
    drift = DriftCheck(who, 40.0, 1.0, 0.12)
    culprit = Culprit(who, drift, 1.0)
    gains = 1 + random.uniform(-0.08, 0.08, (2, n))
    places = np.array([(900.0, 800.0 + 400 * i, 0.0) for i in range(n)])
    sent = []
    ways = np.zeros((2, n))
    u = 0.0
    way = np.zeros((n, 3))
    before = ()
    shots = []
    late = np.array(skew[:n])
    for now in range(FRAME_NS, 3 * SECOND, FRAME_NS):
        if now // SEND_NS != (now - FRAME_NS) // SEND_NS:
            if now * 5 // SECOND != (now - FRAME_NS) * 5 // SECOND:
                u = random.uniform(-2, 2)
            turning = np.array(TURNING[:n]) * np.sin(u - places[:, 2])
            drift.sent(now, SPEEDS[:n], turning)
            sent.append((now + delay_s * SECOND, np.array([SPEEDS[:n], turning])))
        while sent and sent[0][0] <= now:
            swapped = obeys is not None and 3 * SECOND - now < 0.6 * SECOND
            ways = sent.pop(0)[1][:, obeys if swapped else range(n)] * gains
        places[:, 2] += ways[1] * FRAME_NS / SECOND
        courses = np.array([np.cos(places[:, 2]), np.sin(places[:, 2])])
        places[:, :2] += (ways[0] * courses).T * FRAME_NS / SECOND
        noise = random.normal(size=(n, 3)) * (0.3, 0.3, 0.004)
        left_s = (3 * SECOND - now) / SECOND
        shown_places = places + noise + [shown(i, places[i], left_s) for i in range(n)]
        shots.append(shown_places)
        old = [shots[max(-1 - k, -len(shots))][i] for i, k in enumerate(late)]
        poses = tuple(Pose(*map(float, row)) for row in old)
        times = [now - int(k) * FRAME_NS for k in late]
        culprit.see(now, poses, times)
        if left_s > (0.3 if obeys is None else 0.6) and before:  # wheels are learnt until the fault
            way += [motion(then, pose) for then, pose in zip(before, poses, strict=True)]
            drift.frame(now, times, poses, way)
        before = poses
    culprit.suspect = suspect
    return culprit.why(reason)


def pushed(who, size=20.0):
    """A displacement of some robots 0.2 s before the end."""
    return lambda i, place, t: np.array([0.6, 0.8, 0.0]) * size * (t < 0.2 and i in who)


@pytest.mark.parametrize("seed", range(3))
def test_one_robot_that_was_pushed_or_is_shown_elsewhere_is_named_itself(seed):
    assert [accused(pushed([i]), seed=seed, suspect=i) for i in range(3)] == [""] * 3
    assert accused(pushed([1]), seed=seed, who=NAMES[:2], suspect=1) == ""


@pytest.mark.parametrize("seed", range(3))
def test_a_moved_origin_is_the_cameras(seed):
    """Regression: "does the camera track another body as this robot?", 6 of 6."""
    assert accused(pushed([0, 1, 2]), seed=seed) == CAMERA
    assert accused(pushed([0, 1]), seed=seed, who=NAMES[:2]) == CAMERA


def test_a_camera_that_turns_is_the_cameras():
    """Regression: "does not move though commanded to: is a wheel stuck"."""

    def turned(i, place, t):
        angle = 0.1 * max(0.0, 0.3 - t)
        return angle * np.array([-place[1], place[0], 1.0])

    assert accused(turned) == CAMERA


@pytest.mark.parametrize("seed", range(3))
def test_a_slow_radio_is_named_with_its_delay(seed):
    """Regression: "does the camera track another body as this robot?"."""
    assert accused(delay_s=0.5, seed=seed) == RADIO.format(0.5)


@pytest.mark.parametrize("seed", [0, 3, 4])  # in which they are commanded differently
@pytest.mark.parametrize("first, second", [(0, 1), (0, 2), (1, 2)])
def test_two_robots_that_do_what_the_other_is_commanded_are_named_together(seed, first, second):
    obeys = [0, 1, 2]
    obeys[first] = second
    obeys[second] = first
    text = SWAPPED.format(NAMES[first], NAMES[second])
    assert accused(obeys=obeys, seed=seed, suspect=first) == text
    assert accused(obeys=obeys, seed=seed, suspect=second) == text


def test_the_two_of_two_robots_are_named_together_if_they_have_exchanged_numbers():
    assert accused(obeys=[1, 0], who=NAMES[:2], seed=4) == SWAPPED.format(*NAMES[:2])


def test_numbers_are_not_asked_for_if_the_reason_says_what_is_wrong_with_the_robot():
    text = SWAPPED.format(*NAMES[:2])
    assert accused(obeys=[1, 0, 2], seed=3) == text
    assert accused(obeys=[1, 0, 2], seed=3, reason=WRONG_WAY) != text


@pytest.mark.parametrize("seed", range(3))
def test_a_robot_that_was_pushed_sideways_is_not_taken_for_another(seed):
    """One alone that moves as another is commanded is not named: a push may look so."""

    def slid(i, place, t):
        across = np.array([-np.sin(place[2]), np.cos(place[2]), 0.0])
        return 200.0 * max(0.0, 0.1 - t) * across * (i == 1)

    assert accused(slid, seed=seed, suspect=1) == ""


def test_nothing_is_named_but_the_robot_if_it_drives_alone():
    assert accused(pushed([0]), who=NAMES[:1]) == ""


def test_robots_that_all_stand_are_named_themselves():
    """Regression: a radio that fell silent was named as slow, or as a camera that moves."""
    held = {}

    def still(i, place, t):
        if t > 0.2:
            held[i] = place.copy()
        return held[i] - place

    assert accused(still, reason=DOES_NOT_MOVE) == ""


@pytest.mark.parametrize("seed", range(3))
def test_robots_that_are_seen_at_times_of_their_own_are_named_as_others(seed):
    skew = (0, 6, 12)  # up to 0.1 s
    assert accused(pushed([0]), seed=seed, skew=skew) == ""
    assert accused(pushed([0, 1, 2]), seed=seed, skew=skew) == CAMERA
    assert accused(delay_s=0.5, seed=seed, skew=skew) == RADIO.format(0.5)

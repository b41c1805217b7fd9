"""Poses that leave their robots slowly, of three robots that drive as commanded, at 120 Hz."""

import re

import numpy as np
import pytest

from tetractl.core.clock import SECOND
from tetractl.core.poses import Pose
from tetractl.lab import drift_check
from tetractl.lab.drift_check import TOGETHER, DriftCheck
from tetractl.lab.motion_check import motion

NAMES = ("green", "blue", "red")
SPEED = 180.0
FRAME_NS = SECOND // 120


def drifting(
    shown,
    seconds=20.0,
    seed=1,
    share=0.06,
    checks=None,
    noisy=1.0,
    lag_s=0.0,
    most=1.5,
    rate_hz=5,
    astray=lambda t: 0.0,
):
    """Return what is said first, and when [s], if the camera adds `shown` (3, 3) [mm, mm, rad] to
    the robots' true places (3, 3) t s after the start; wheels are up to `share` off, and poses
    `noisy` times as noisy as usual. Robots are turned by up to `most` [rad/s], `rate_hz` times a
    second, which acts after wheels' lag, and by `astray(t)`.

    The check is added to `checks`.
    """
    random = np.random.default_rng(seed)
    check = DriftCheck(NAMES, 40.0, 1.0, 0.12)
    gains = 1 + random.uniform(-share, share, 3)
    (checks if checks is not None else []).append(check)
    places = np.array([(900.0, 800.0 + 400 * i, 0.0) for i in range(3)])
    way = 0.0
    before = ()
    turning = rate = np.zeros(3)
    for now in range(FRAME_NS, round(seconds * SECOND), FRAME_NS):
        if not before or now * rate_hz // SECOND != (now - FRAME_NS) * rate_hz // SECOND:
            turning = random.uniform(-most, most, 3)
            check.sent(now - SECOND // 20, [SPEED] * 3, turning)  # the delay of the radio
        rate = rate + (turning - rate) * (-np.expm1(-FRAME_NS / SECOND / lag_s) if lag_s else 1.0)
        places[:, 2] += (rate * gains + astray(now / SECOND)) * FRAME_NS / SECOND
        courses = np.array([np.cos(places[:, 2]), np.sin(places[:, 2])])
        places[:, :2] += SPEED * (gains * courses).T * FRAME_NS / SECOND
        noise = noisy * random.normal(size=(3, 3)) * (0.3, 0.3, 0.004)
        rows = places + noise + shown(places, now / SECOND)
        poses = [Pose(*map(float, row)) for row in rows]
        if before:
            way += np.array([motion(then, pose) for then, pose in zip(before, poses, strict=True)])
            said = check.frame(now, [now] * len(poses), poses, way).text
            if said:
                return said, now / SECOND
        before = poses
    return "", seconds


def test_robots_that_drive_as_commanded_are_let():
    assert drifting(lambda places, t: 0.0)[0] == ""


def test_robots_before_a_camera_eight_times_as_noisy_as_usual_are_let():
    assert drifting(lambda places, t: 0.0, 4.0, noisy=8.0)[0] == ""


def test_a_robot_that_lost_packets_turn_for_a_third_of_a_second_is_let():
    """Regression: two packets were lost, and slow wheels followed the next one late: in seven
    blocks, one after another, the robot turned on by more than is counted.
    """
    on = [
        drifting(lambda places, t: 0.0, 8.0, k, astray=lambda t: 0.9 * (6.0 <= t < 6.35))[0]
        for k in range(6)
    ]
    assert on == [""] * 6


@pytest.mark.parametrize(("rate_hz", "limit"), [(5, 10.0), (20, 13.0)])
def test_robots_with_slow_wheels_that_are_turned_to_and_fro_are_let(rate_hz, limit, monkeypatch):
    """Regression: what is left of a reversal 0.2 s later was taken for a pose that turns; in 14
    trials the statistic reached 13, it reaches 9; if it lasted for 50 ms, 13.3, it reaches 12.2.
    """
    monkeypatch.setattr(drift_check, "LIMIT", limit)
    settings = {"lag_s": 0.08, "most": 8.0, "rate_hz": rate_hz}
    faults = [drifting(lambda places, t: 0.0, 60 / rate_hz, k, **settings)[0] for k in range(14)]
    assert faults == [""] * 14


def test_a_rest_leaves_out_the_ways_that_were_still_to_be_counted():
    checks = []
    pushed = np.array([[20.0, 0.0, 0.0], [0.0] * 3, [0.0] * 3])
    drifting(lambda places, t: pushed * (t > 1.95), 2.0, checks=checks)
    assert checks[0]._carried.any()
    checks[0].rest()
    assert not checks[0]._carried.any()


@pytest.mark.parametrize("who", [0, 2])
def test_a_drift_in_steps_is_noticed(who):
    """Regression: each step of 4 mm was clipped as if it were an error of one frame."""

    def steps(places, t):
        off = np.zeros((3, 3))
        off[who, :2] = np.array([2.4, 3.2]) * (max(0.0, t - 2.0) // 0.5)
        return off

    said, noticed_s = drifting(steps, seed=2)
    assert said.startswith(f"{NAMES[who]} moves ")
    assert noticed_s < 9.0


@pytest.mark.parametrize("seed", range(6))
def test_one_robot_that_is_pushed_and_turned_is_not_the_cameras(seed):
    """Regression: in some of them "all robots drift together"."""
    angle = np.random.default_rng(100 + seed).uniform(0.0, 6.28)
    push = np.array([20 * np.cos(angle), 20 * np.sin(angle), 0.2])

    def pushed(places, t):
        return np.outer([1.0, 0.0, 0.0], push * min(1.0, max(0.0, (t - 3.0) / 0.2)))

    assert drifting(pushed, 9.0, seed)[0].startswith("green moves ")


def test_a_picture_that_turns_is_the_cameras():
    def turned(places, t):
        angle = 0.015 * max(0.0, t - 2.0)
        x, y, _ = places.T
        return angle * np.column_stack([-y, x, np.ones(3)])

    assert drifting(turned)[0] == TOGETHER


def test_a_turn_that_one_trial_cannot_distinguish_from_wheels_is_stated():
    """A pose that turns from the start on at 0.2 rad/s, in heading and course."""
    checks = []
    state = {"t": 0.0, "places": None, "off": np.zeros(2)}

    def turned(places, t):
        if state["places"] is not None:
            x, y = (places - state["places"])[0, :2]
            cos = np.cos(0.2 * t)
            sin = np.sin(0.2 * t)
            state["off"] += cos * x - sin * y - x, sin * x + cos * y - y
        state["places"] = places.copy()
        return np.array([[*state["off"], 0.2 * t], [0.0] * 3, [0.0] * 3])

    assert drifting(turned, 6.0, share=0.0, checks=checks)[0] == ""
    text = checks[0].turns()
    rate, error = map(float, re.search(r"green ([+\d.]+) ± ([\d.]+) rad/s$", text).groups())
    assert rate == pytest.approx(0.2, abs=3 * error + 0.02)
    assert "blue" not in text


def test_a_trials_turns_are_those_of_its_wheels_whatever_is_expected_of_wheels():
    """Their difference is in the standard errors, and a robot that does not drive has no rate."""
    random = np.random.default_rng(3)
    check = DriftCheck(NAMES, 40.0, 1.0, 0.12)
    assert check.turning() == ((), ())
    constants = np.array([0.3, -0.5, 0.1])
    off = []
    for seconds in (1.0, 20.0):
        poses = np.zeros((3, 3))
        way = np.zeros((3, 3))
        last = ()
        check = DriftCheck(NAMES, 40.0, 1.0, 0.12)
        for now in range(FRAME_NS, round(seconds * SECOND), FRAME_NS):
            check.sent(now - SECOND // 20, [SPEED, SPEED, 0.0], np.zeros(3))
            speed = np.array([SPEED, SPEED, 0.0])
            poses[:, 2] += constants * (speed > 0) * FRAME_NS / SECOND
            courses = np.array([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
            poses[:, :2] += (speed * courses).T * FRAME_NS / SECOND
            poses_shown = [
                Pose(*map(float, row)) for row in poses + random.normal(0, 0.003, (3, 3))
            ]
            if last:
                pairs = zip(last, poses_shown, strict=True)
                way = way + np.array([motion(then, pose) for then, pose in pairs])
                check.frame(now, [now] * len(poses_shown), poses_shown, way)
            last = poses_shown
        rates, errors = map(np.array, check.turning())
        off.append(np.abs(rates - constants)[:2] / errors[:2])
        assert errors[2] == np.inf
    assert np.max(off) < 3.0 and errors[0] < 0.02

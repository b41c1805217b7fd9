"""Tests of warnings about robots that move while all should stand still."""

import numpy as np
import pytest
from testkit.trials import experiment

from tetractl.core.clock import SECOND
from tetractl.core.commands import Stop
from tetractl.core.plan import Plan, State
from tetractl.core.poses import Observation, Poses
from tetractl.run.motion_at_rest import WINDOW_S, RestMonitor, speeds_at_rest

SETUP = experiment().setup
GREEN = SETUP.names[0]
RATE_HZ = 100
NOISE_MM = 0.3


def frames(speed_mm_s, noise_mm=NOISE_MM, seconds=0.55, seed=0, rate_hz=RATE_HZ):
    """Frames of a rest in which the first robot moves along x."""
    random = np.random.default_rng(seed)
    number = round(seconds * rate_hz)
    at_s = np.arange(number) / rate_hz
    xy = np.repeat(SETUP.starts.xy[None], number, axis=0)
    xy += random.normal(0, noise_mm, xy.shape)
    xy[:, 0, 0] += speed_mm_s * at_s
    heading = np.zeros(len(SETUP.names))
    valid = np.ones(len(SETUP.names), dtype=np.bool_)
    times_ns = [round(s * SECOND) for s in at_s.tolist()]
    return [
        Observation(k, t, t, Poses(x, y, heading), valid)
        for k, (t, (x, y)) in enumerate(zip(times_ns, np.moveaxis(xy, 1, 2), strict=True))
    ]


def plan(instead):
    """A plan in place of whose first signal something else was sent."""
    path = np.zeros((2, len(SETUP.names), 3))
    return Plan(np.zeros(1), path, 0.0, 0.0, 0.0, (), 0, 0, None, instead, State.RESTING)


@pytest.mark.parametrize(("speed_mm_s", "told"), [(30.0, 1), (5.0, 0), (0.0, 0)])
def test_a_robot_that_moves_in_rests_is_said_once(speed_mm_s, told):
    monitor = RestMonitor(SETUP)
    stop = plan(Stop())
    texts = [
        text for seed in range(4) for text in monitor.warnings(stop, frames(speed_mm_s, seed=seed))
    ]
    assert len(texts) == told
    assert all(
        f"{GREEN} moves by " in text and "although it should stand still" in text for text in texts
    )


def test_a_robot_that_missed_the_stop_and_was_stopped_by_its_watchdog_is_not_said():
    """It moved until the last WINDOW_S of the rest."""
    monitor = RestMonitor(SETUP)
    moving = frames(200.0, seconds=0.55 - WINDOW_S)
    standing = frames(0.0, seconds=0.55)[len(moving) :]
    assert monitor.warnings(plan(Stop()), [*moving, *standing]) == []


def test_few_frames_or_a_lost_robot_say_nothing():
    few = frames(100.0, rate_hz=round(5 / WINDOW_S))
    assert not speeds_at_rest(few).any()
    assert not speeds_at_rest(few[-1:]).any()


def test_robots_that_stand_hardly_ever_seem_to_move_by_noise():
    """Also with a camera of 2 mm of noise: 5 standard deviations, of 14 frames, in 900 cases."""
    least = 0.05 * SETUP.speed
    assert (
        sum(
            (speeds_at_rest(frames(0.0, noise_mm=2.0, seed=seed)) > least).sum()
            for seed in range(300)
        )
        <= 2
    )

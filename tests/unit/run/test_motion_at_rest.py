"""Tests of warnings about robots that move while all should stand still."""

from dataclasses import replace

import numpy as np
import pytest
from testkit.trials import experiment

from tetractl.core.clock import SECOND
from tetractl.core.commands import Stop, Turn
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


def moved(frame, x, y=0.0):
    """The frame with its robots moved by x and y [mm], each a number for every robot."""
    poses = replace(frame.poses, x=frame.poses.x + x, y=frame.poses.y + y)
    return replace(frame, poses=poses)


def with_green_moved(shown, numbers, by_mm):
    """The frames, of which some show the first robot farther along x."""
    by = np.array([by_mm, 0, 0])
    return [moved(frame, by) if k in numbers else frame for k, frame in enumerate(shown)]


@pytest.mark.parametrize("angle", [0.0, 0.5, 2.0, 4.0])
def test_the_speed_of_a_robot_is_the_same_in_every_direction(angle):
    """Without noise, half a window lies between the means of its halves."""
    speeds = np.array([0.0, 20.0, 40.0])
    vx, vy = speeds * np.cos(angle), speeds * np.sin(angle)
    still = frames(0.0, noise_mm=0.0)
    moving = [moved(frame, vx * frame.seconds, vy * frame.seconds) for frame in still]
    assert speeds_at_rest(moving) == pytest.approx(speeds)


def test_only_the_end_of_the_frames_counts_and_only_frames_that_show_all_robots():
    still = frames(0.0, noise_mm=0.0, seconds=0.55)
    seen = np.array([frame.sampled_ns for frame in still])
    first = int(np.searchsorted(seen, seen[-1] - round(WINDOW_S * SECOND)))

    def pushed_at(number):
        return with_green_moved(still, range(number, len(still)), 1.0)

    assert speeds_at_rest(pushed_at(first)).tolist() == [0.0] * 3  # before the window
    middle = (first + len(still)) // 2
    assert speeds_at_rest(pushed_at(middle))[0] > 0
    invisible = with_green_moved(still, {middle}, 50.0)
    invisible[middle] = replace(invisible[middle], valid=np.array([False, True, True]))
    assert speeds_at_rest(invisible).tolist() == [0.0] * 3


@pytest.mark.parametrize(("count", "told"), [(5, False), (6, True)])
def test_six_frames_are_enough(count, told):
    shown = frames(0.0, noise_mm=0.01)[-count:]
    pushed = with_green_moved(shown, range(count // 2, count), 1.0)
    assert speeds_at_rest(pushed).any() == told


def test_only_a_stop_is_watched():
    moving = frames(100.0, noise_mm=0.01)
    for instead in (None, Turn(0.0)):
        assert RestMonitor(SETUP).warnings(plan(instead), moving) == []
    assert len(RestMonitor(SETUP).warnings(plan(Stop()), moving)) == 1


@pytest.mark.parametrize(("share", "told"), [(0.045, False), (0.055, True)])
def test_a_robot_is_told_from_a_twentieth_of_its_own_speed(share, told):
    creeping = frames(share * SETUP.speed[0], noise_mm=0.0)
    (*texts,) = RestMonitor(SETUP).warnings(plan(Stop()), creeping)
    assert len(texts) == told
    if told:
        speed = f"{share * SETUP.speed[0]:.2g} {SETUP.unit}/s"
        assert texts == [f"{GREEN} moves by {speed} although it should stand still"]

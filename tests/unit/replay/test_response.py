"""What robots on two wheels make of their commands, found in motions whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest

from tetractl.replay.identification.fit import SampleInterval
from tetractl.replay.identification.response import respond, response_table
from tetractl.replay.identification.tracks import Track

TRUE = {
    "dead_time": 0.12,
    "turning_lag": 0.08,
    "speed_lag": 0.15,
    "turning_gain": 0.93,
    "speed_gain": 1.04,
    "veer": 0.0004,
    "heading_walk": 0.02,
    "way_walk": 2.0,
}
NOISE = (0.3, 0.003)  # of measured positions [mm] and headings [rad]
FINE, SECONDS = 0.005, 30.0


def track(seed):
    """Return a robot's track: commands at about 20 Hz, frames at 50."""
    rng = np.random.default_rng(seed)
    count = round(SECONDS / 0.05)
    sent = np.arange(count) * 0.05 + rng.uniform(0, 0.01, count)
    twists = np.repeat(rng.uniform((40, -1.5), (160, 1.5), (count // 10, 2)), 10, axis=0)
    t = np.arange(0.0, SECONDS, FINE)
    last = np.searchsorted(sent, t + FINE / 2 - TRUE["dead_time"], side="right") - 1
    drop = np.exp(-FINE / np.array([TRUE["speed_lag"], TRUE["turning_lag"]]))
    steps = rng.standard_normal((len(t), 2)) * (TRUE["way_walk"], TRUE["heading_walk"]) * FINE**0.5
    path, pose, follows = np.empty((len(t), 3)), np.zeros(3), twists[0]
    for k, command in enumerate(twists[np.maximum(last, 0)]):
        path[k] = pose
        before, follows = follows, command + (follows - command) * drop
        p, q = (before + follows) / 2
        turned = TRUE["turning_gain"] * q + TRUE["veer"] * p
        way, turn = steps[k] + FINE * np.array([TRUE["speed_gain"] * p, turned])
        middle = pose[2] + turn / 2
        pose = pose + np.array([way * np.cos(middle), way * np.sin(middle), turn])
    seen = path[::4] + rng.standard_normal((len(t[::4]), 3)) * (NOISE[0], *NOISE)
    valid = np.ones((len(seen), 1), dtype=bool)
    driven = {"sent": sent, "u": np.full(count, np.nan), "twists": twists[:, None]}
    return Track(
        "a test", "test", "mm", ("one",), t[::4], seen[:, None], valid, until=60.0, **driven
    )


def test_gains_lags_and_dead_time_are_found_and_intervals_hold_them():
    held = []
    for seed in range(2):
        (found,) = respond([track(seed)])
        values = found.quantities
        for name, true in TRUE.items():
            assert values[name].value == pytest.approx(true, rel=0.25, abs=2e-4), (seed, name)
            held.append(values[name].low <= true <= values[name].high)
        assert values["turning_gain"].value == pytest.approx(TRUE["turning_gain"], rel=0.02)
    assert np.mean(held) >= 0.8, held


def test_tracks_are_pooled_and_a_body_taken_for_another_is_left_out():
    one, other = track(4), track(5)
    (whole,) = respond([one, other])
    assert (whole.intervals, whole.left_out) == (pytest.approx(2 * SECONDS / 0.1, rel=0.02), 0)
    width = whole.dead_time.high - whole.dead_time.low
    one.poses[1000:1005] += (300.0, 0.0, 1.0)
    (found,) = respond([one, other])
    assert found.left_out == 2
    (_, column) = response_table([found], "", "mm").columns
    assert column.values[-1] == f"2 of {found.intervals + 2}"
    assert found.dead_time.high - found.dead_time.low < 1.1 * width


@pytest.mark.parametrize(
    ("lag", "said"),
    [(0.09, "the lag of turning for a spec: lab.lag=0.08"), (0.2, "no single lag fits all")],
)
def test_a_lag_for_a_spec_is_said_if_it_fits_all_robots(lag, said):
    (one,) = respond([track(6)])
    other = replace(one, turning_lag=SampleInterval(lag, lag - 0.01, lag + 0.01))
    assert said in response_table([one, other], "", "mm").note

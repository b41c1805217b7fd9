"""Tests whether an unknown lag of the wheels could explain how robots turn."""

from dataclasses import replace

import numpy as np
import pytest
from tetractl_identify.tracks import Track
from tetractl_identify.wheel_lag import may_lag_explain_turns

A_RAD_S = 4.0
DEAD_TIME_S = 0.1
DRIVE_S = 60.0
SUBSTEP_S = 0.005
FRAME = 6  # substeps, at 33 Hz
HEADING_NOISE_RAD = 0.003
HEADING_WALK = 0.02  # rad/sqrt(s)
PERIOD_S = 0.2
SENT_S = np.arange(0.0, DRIVE_S, PERIOD_S)


def random_turns():
    """Directions [rad] of which one in five jumps, as of a controller."""
    random = np.random.default_rng(3)
    small = 0.05 * random.normal(size=len(SENT_S))
    jumps = random.uniform(-2, 2, len(SENT_S))
    return np.cumsum(np.where(random.uniform(size=len(SENT_S)) < 0.2, jumps, small))


def turned(
    directions=None, lag_s=0.0, foresees=False, seen_late_s=0.0, lost=0.0, noise=HEADING_NOISE_RAD
):
    """The track of a robot that turns by directions (C,) [rad] with wheels that lag; its host may
    foresee their lag, or see headings late."""
    random = np.random.default_rng(1)
    directions = random_turns() if directions is None else directions
    acts = np.where(random.uniform(size=len(SENT_S)) < lost, 0, np.arange(len(SENT_S)))
    acting = directions[np.maximum.accumulate(acts)]
    times = np.arange(0.0, DRIVE_S, SUBSTEP_S)
    newest = np.maximum(np.searchsorted(SENT_S, times - DEAD_TIME_S, side="right") - 1, 0)
    steps = HEADING_WALK * np.sqrt(SUBSTEP_S) * random.normal(size=len(times))
    late = round(seen_late_s / SUBSTEP_S)
    headings = np.zeros(len(times) + 1)
    rate = 0.0
    for k in range(len(times)):
        seen = headings[max(k - late, 0)] + (lag_s * rate if foresees else 0.0)
        asked = A_RAD_S * np.sin(acting[newest[k]] - seen)
        rate += (asked - rate) * min(1.0, SUBSTEP_S / lag_s if lag_s else 1.0)
        headings[k + 1] = headings[k] + rate * SUBSTEP_S + steps[k]
    frames = np.arange(0, len(times), FRAME)
    measured = headings[frames] + noise * random.normal(size=len(frames))
    poses = np.zeros((len(frames), 1, 3))
    poses[:, 0, 2] = np.angle(np.exp(1j * measured))
    return Track(
        source="p.csv",
        origin="CSV",
        unit="mm",
        names=("r1",),
        time_s=times[frames],
        poses=poses,
        valid=np.ones((len(frames), 1), dtype=bool),
        sent_s=SENT_S,
        direction_rad=directions,
        stop_s=DRIVE_S,
        on_wheels=True,
    )


SINE = np.sin(0.8 * SENT_S)
TRIANGLE = 1.5 - np.abs(SENT_S % 6 - 3)
LAGGING = {
    "wheels that lag": {"lag_s": 0.04},
    "longer": {"lag_s": 0.1},
    "a host that foresees the lag": {"lag_s": 0.06, "foresees": True},
    "and commands lost": {"lag_s": 0.06, "foresees": True, "lost": 0.05},
    "a host that sees headings late": {"seen_late_s": 0.05},
    "a noisy camera": {"lag_s": 0.04, "noise": 0.02},
    "a sine, which shows no lag": {"directions": SINE},
    "a triangle, by wheels that lag": {"directions": TRIANGLE, "lag_s": 0.04},
    "directions that hardly turn": {"directions": 0.1 * SINE},
}


@pytest.mark.parametrize("name", LAGGING)
def test_a_lag_that_may_be_there_is_seen(name):
    """Regression: a dead time of .178 (.174 to .181) for .1175 s, exit code 0."""
    track = turned(**LAGGING[name])
    assert may_lag_explain_turns([track], DEAD_TIME_S + 0.03)


def with_gap(track):
    """The robot is not tracked for 10 s."""
    return replace(track, valid=track.valid & (np.abs(track.time_s - 30) > 5)[:, None])


PLAIN = turned()
WITHOUT_LAG = {
    "as it is": PLAIN,
    "no noise": turned(noise=1e-9),
    "twice the noise": turned(noise=2 * HEADING_NOISE_RAD),
    "a tenth of the commands lost": turned(lost=0.1),
    "not tracked for 10 s": with_gap(PLAIN),
    "clocks 3 s off": replace(PLAIN, sent_s=PLAIN.sent_s - 3.0, stop_s=PLAIN.stop_s - 3.0),
}


@pytest.mark.parametrize("name", WITHOUT_LAG)
def test_no_lag_is_seen_where_wheels_follow_at_once(name):
    dead_time_s = DEAD_TIME_S + (3.0 if "clocks" in name else 0.0)
    assert not may_lag_explain_turns([WITHOUT_LAG[name]], dead_time_s)


def test_a_robot_that_is_hardly_seen_shows_nothing():
    track = replace(PLAIN, valid=PLAIN.valid & (PLAIN.time_s < 0.55)[:, None])
    assert may_lag_explain_turns([track], DEAD_TIME_S)
    never = replace(PLAIN, valid=np.zeros_like(PLAIN.valid))
    assert may_lag_explain_turns([never], DEAD_TIME_S)

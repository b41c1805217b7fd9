import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.wheels import train

pytestmark = pytest.mark.slow

gains = st.builds(lambda gain, back: -gain if back else gain, st.floats(4.0, 12.0), st.booleans())
zones = st.tuples(st.integers(0, 20), st.integers(0, 20))
trains = st.builds(train, st.tuples(gains, gains), zones, st.integers(21, 127), st.booleans())
halves = st.floats(-0.5, 0.5)
owing = st.tuples(halves, halves)
speeds = st.floats(-2000.0, 2000.0)
finite = st.floats(allow_nan=False, allow_infinity=False)


def sent(pair, drive_train, owed=(0.0, 0.0)):
    """Return the counts (2, 1) for a pair of speeds, what is owed, and the speeds of the counts."""
    counts, owed = drive_train.counts(np.array(pair)[:, None], np.array(owed)[:, None])
    return counts, owed, drive_train.speeds(counts)


@given(speeds, speeds, trains)
def test_the_mean_of_what_is_sent_is_what_was_wished(left, right, drive_train):
    tops = np.abs(drive_train.gain) * (drive_train.limit - drive_train.dead_zone)
    wished = np.array([[left], [right]])
    scale = 1 / max(1.0, float((np.abs(wished) / tops).max()))
    owed = np.zeros((2, 1))
    total = np.zeros((2, 1))
    steps = 64
    for _ in range(steps):
        _, owed, speeds = sent((left, right), drive_train, owed[:, 0])
        total += speeds
    assert (
        np.abs(total / steps - wished * scale) <= np.abs(drive_train.gain) * 0.51 / steps + 1e-9
    ).all()


@given(finite, finite, trains, owing)
def test_counts_never_leave_the_limits(left, right, drive_train, owed):
    counts, after, speeds = sent((left, right), drive_train, owed)
    assert np.abs(counts).max() <= drive_train.limit[0]
    assert counts.dtype == np.int64
    assert np.abs(after).max() <= 0.5
    for speed, wish in zip(speeds, (left, right), strict=True):
        assert speed == 0 or (speed > 0) == (wish > 0)


@given(trains, owing, st.sampled_from([0.0, -0.0]))
def test_stop_is_exactly_zero_whatever_is_owed(drive_train, owed, zero):
    counts, after, speeds = sent((zero, 0.0), drive_train, owed)
    assert not counts.any()
    assert not after.any()
    assert not speeds.any()


@given(speeds, trains, owing)
def test_a_wheel_wished_to_stand_stands(speed, drive_train, owed):
    counts, after, speeds = sent((speed, 0.0), drive_train, owed)
    assert speeds[1] == 0.0
    assert counts[0 if drive_train.swap[0] else 1] == 0
    assert speed == 0 or after[1] == owed[1]


@given(speeds, speeds, trains, owing)
def test_nothing_is_sent_inside_the_dead_zone(left, right, drive_train, owed):
    counts, _, _ = sent((left, right), drive_train, owed)
    in_own_order = counts[::-1] if drive_train.swap[0] else counts
    assert ((in_own_order == 0) | (np.abs(in_own_order) > drive_train.dead_zone)).all()


def test_swap_and_invert():
    for drive_train, counts in (
        (train(), (10, 20)),
        (train(swap=True), (20, 10)),
        (train((-10.0, 10.0)), (-10, 20)),
        (train((-10.0, 10.0), swap=True), (20, -10)),
        (train(dead_zone=(8, 0)), (18, 20)),
        (train(limit=10), (5, 10)),
    ):
        outputs, _, _ = sent((100.0, 200.0), drive_train)
        assert tuple(outputs[:, 0]) == counts
    assert train(dead_zone=(8, 0)).speeds(np.array([[18], [20]])).tolist() == [[100.0], [200.0]]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_speeds_that_are_not_finite_are_refused(bad):
    for pair in ((bad, 1.0), (1.0, bad), (bad, bad), (bad, 0.0)):
        with pytest.raises(ValueError, match="finite"):
            sent(pair, train())

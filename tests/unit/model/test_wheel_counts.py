"""Tests of converting wished wheel speeds [mm/s] to counts, left and right."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.wheels import train

pytestmark = pytest.mark.slow

GAINS = st.floats(4.0, 12.0) | st.floats(-12.0, -4.0)  # negative: a wheel that is turned round
ZONES = st.tuples(st.integers(0, 20), st.integers(0, 20))
LIMITS = st.integers(21, 127)
TRAINS = st.builds(train, st.tuples(GAINS, GAINS), ZONES, LIMITS, swap=st.booleans())
OWED = st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
"""Counts that rounding has left to send, of both wheels."""
SPEEDS = st.floats(-2000.0, 2000.0)
BOTH_SPEEDS = st.tuples(SPEEDS, SPEEDS)
FINITE = st.floats(allow_nan=False, allow_infinity=False)


class Sent(NamedTuple):
    """What is sent to the two motor channels, and what it does to the left and right wheel."""

    counts: np.ndarray  # (2,) in the order of the channels
    owed: np.ndarray  # (2,) counts that are owed after it
    speeds: np.ndarray  # (2,) speeds of the wheels at these counts [mm/s]


def send(wished, drive_train, owed=(0.0, 0.0)):
    counts, owed_after = drive_train.counts(np.array([wished]).T, np.array([owed]).T)
    speeds = drive_train.speeds(counts)
    return Sent(counts[:, 0], owed_after[:, 0], speeds[:, 0])


def counts_by_wheel(sent, drive_train):
    """The counts in the order of the wheels."""
    return sent.counts[::-1] if drive_train.swap[0] else sent.counts


@given(BOTH_SPEEDS, TRAINS)
def test_the_mean_of_what_is_sent_is_what_was_wished(wished, drive_train):
    """Speeds above the greatest one are scaled together. After so many steps less than a count of
    rounding is owed, shared by all of them."""
    steps = 64
    gain = np.abs(drive_train.gain[:, 0])
    greatest = gain * (drive_train.limit - drive_train.dead_zone[:, 0])
    too_fast = (np.abs(wished) / greatest).max()
    expected = np.array(wished) / max(1.0, too_fast)

    owed = (0.0, 0.0)
    speeds = []
    for _ in range(steps):
        sent = send(wished, drive_train, owed)
        owed = sent.owed
        speeds.append(sent.speeds)

    off = np.abs(np.mean(speeds, axis=0) - expected)
    assert (off <= gain * 0.51 / steps + 1e-9).all()


@given(st.tuples(FINITE, FINITE), TRAINS, OWED)
def test_counts_never_leave_the_limits(wished, drive_train, owed):
    sent = send(wished, drive_train, owed)
    assert np.abs(sent.counts).max() <= drive_train.limit[0]
    assert sent.counts.dtype == np.int64
    assert np.abs(sent.owed).max() <= 0.5


@given(BOTH_SPEEDS, TRAINS, OWED)
def test_nothing_is_sent_inside_the_dead_zone(wished, drive_train, owed):
    counts = counts_by_wheel(send(wished, drive_train, owed), drive_train)
    beyond = np.abs(counts) > drive_train.dead_zone[:, 0]
    assert ((counts == 0) | beyond).all()


@pytest.mark.parametrize(
    ("drive_train", "counts"),
    [
        (train(), (10, 20)),  # 100 and 200 mm/s at 10 mm/s a count
        (train(swap=True), (20, 10)),
        (train((-10.0, 10.0)), (-10, 20)),
        (train((-10.0, 10.0), swap=True), (20, -10)),
        (train(dead_zone=(8, 0)), (8 + 10, 20)),
        (train(limit=10), (5, 10)),  # both scaled by a half
    ],
)
def test_counts_are_those_of_how_the_wheels_are_built_in(drive_train, counts):
    assert tuple(send((100.0, 200.0), drive_train).counts) == counts


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_speeds_that_are_not_finite_are_refused(bad):
    for pair in ((bad, 1.0), (1.0, bad), (bad, bad), (bad, 0.0)):
        with pytest.raises(ValueError, match="finite"):
            send(pair, train())

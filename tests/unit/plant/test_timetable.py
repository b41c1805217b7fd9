"""Tests of when a simulation exposes frames and samples the true path."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tetractl.core.clock import SECOND
from tetractl.plant.timetable import DueTimes, Timetable

RATES = st.sampled_from([1.0, 2.5, 24.0, 29.97, 30.0, 100.0, 120.0])
FINER = st.sampled_from([1.0, 1.5, 4.0, 8.0])
STEPS = st.lists(st.tuples(st.integers(0, 3 * SECOND), st.booleans()), min_size=1, max_size=6)


def multiples(rate_hz, until_ns):
    """All times k / rate up to a time [ns], exactly rounded."""
    rate = Fraction(rate_hz)
    count = int(until_ns * rate / SECOND) + 2
    times_ns = [round(k * SECOND / rate) for k in range(count)]
    return [time_ns for time_ns in times_ns if time_ns <= until_ns]


@given(RATES, FINER, STEPS)
@settings(max_examples=60)
def test_every_frame_and_sample_is_due_once_in_order_however_the_times_are_taken(
    camera_hz, finer, steps
):
    truth_hz = camera_hz * finer
    table = Timetable(camera_hz, truth_hz)
    frames, samples, until_ns = [], [], 0
    for step_ns, with_end in steps:
        until_ns += step_ns
        due = table.take_until(until_ns, with_end)
        assert (np.diff(due.times_ns) > 0).all()
        if with_end and due.times_ns.size:
            assert due.times_ns[-1] == until_ns
        bare = due.times_ns[~(due.has_frame | due.has_sample)]
        assert bare.size == 0 or (with_end and bare.tolist() == [until_ns])
        frames += due.times_ns[due.has_frame].tolist()
        samples += due.times_ns[due.has_sample].tolist()
    # the last bit of a rate that is no whole number may round a time to its neighbour
    assert np.abs(np.subtract(frames, multiples(camera_hz, until_ns))).max() <= 1
    assert np.abs(np.subtract(samples, multiples(truth_hz, until_ns))).max() <= 1


def test_the_end_is_taken_even_if_nothing_is_due_then():
    table = Timetable(10.0, 10.0)
    due = table.take_until(SECOND // 20, with_end=True)
    assert due.times_ns.tolist() == [0, SECOND // 20]
    assert due.has_frame.tolist() == due.has_sample.tolist() == [True, False]
    assert table.take_until(SECOND // 15, with_end=True).times_ns.tolist() == [SECOND // 15]
    assert table.take_until(SECOND // 10, with_end=False).has_frame.tolist() == [True]


def test_an_end_at_which_a_frame_is_due_is_that_frame():
    due = Timetable(10.0, 10.0).take_until(SECOND // 10, with_end=True)
    assert due.times_ns.tolist() == [0, SECOND // 10]
    assert due.has_frame.all() and due.has_sample.all()


@pytest.mark.parametrize("with_end", [False, True])
def test_the_next_times_are_the_first_that_were_not_taken(with_end):
    table = Timetable(10.0, 40.0)
    assert (table.next_ns, table.next_frame_ns) == (0, 0)
    table.take_until(0, with_end)
    assert (table.next_ns, table.next_frame_ns) == (SECOND // 40, SECOND // 10)
    table.take_until(SECOND // 10 - 1, with_end)
    assert (table.next_ns, table.next_frame_ns) == (SECOND // 10, SECOND // 10)
    table.take_until(SECOND // 10, with_end)
    assert (table.next_ns, table.next_frame_ns) == (SECOND // 8, SECOND // 5)


def test_a_trial_of_many_minutes_keeps_its_times():
    """The table is laid out in blocks of a few seconds."""
    table = Timetable(1.0, 1.0)
    times_ns = np.concatenate(
        [table.take_until(k * SECOND // 2, False).times_ns for k in range(1200)]
    )
    assert times_ns.tolist() == [k * SECOND for k in range(600)]


def test_a_part_is_a_copy_of_its_rows():
    flags = np.array([True, False, True])
    due = DueTimes(np.array([1, 2, 3]), flags, ~flags)
    part = due.select_rows(1, 3)
    part.times_ns[0] = 7
    assert due.times_ns.tolist() == [1, 2, 3]
    assert part.times_ns.tolist() == [7, 3]
    assert part.has_frame.tolist() == [False, True]
    assert part.has_sample.tolist() == [True, False]

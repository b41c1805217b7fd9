"""Tests of comparing a logged record with the same record computed again."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.commands import Steer, Turn
from tetractl.verification.comparison import Tolerance, first_difference

SPECIAL = st.sampled_from([0.0, -0.0, 1.0, 1.0 + 2**-52, math.inf, -math.inf, math.nan])
numbers = st.lists(st.tuples(SPECIAL | st.floats(-9, 9), SPECIAL | st.floats(-9, 9)), min_size=1)


@given(numbers)
def test_without_a_tolerance_numbers_are_the_same_if_their_bits_are_or_both_are_nan(pairs):
    ours, logged = np.array(pairs).T
    expected = [
        struct.pack("d", one) != struct.pack("d", other)
        and not (math.isnan(one) and math.isnan(other))
        for one, other in pairs
    ]
    assert Tolerance().differs(ours, logged).tolist() == expected
    assert Tolerance().differs(ours[None], logged[None]).shape == (1, len(pairs))


@given(numbers, st.sampled_from([(0.1, 0.0), (0.0, 0.5), (0.1, 0.5)]))
def test_with_a_tolerance_numbers_may_differ_by_as_much(pairs, shares):
    relative, absolute = shares

    def differ(one, other):
        if math.isnan(one) or math.isnan(other):
            return not (math.isnan(one) and math.isnan(other))
        if math.isinf(one) or math.isinf(other):
            return one != other
        return abs(one - other) > relative * max(abs(one), abs(other)) + absolute

    ours, logged = np.array(pairs).T
    differs = Tolerance(relative, absolute).differs(ours, logged)
    assert differs.tolist() == [differ(*pair) for pair in pairs]


def test_values_that_are_no_floats_are_compared_by_value():
    assert Tolerance(0.1, 5).differs(np.array([1, 2]), np.array([1, 3])).tolist() == [False, True]


@pytest.mark.parametrize(
    ("ours", "logged", "message"),
    [
        (1.5, "1.5", "logged '1.5', computed 1.5"),
        (np.zeros(2), "0 0", "logged str, computed ndarray"),
        ("0 0", np.zeros(2), "logged ndarray, computed str"),
        ([1], 3, "logged an int, computed a list"),
        (np.zeros(2), np.zeros(3), "logged shape (3,), computed (2,)"),
    ],
)
def test_values_of_two_kinds_differ(ours, logged, message):
    difference = first_difference({"value": ours}, {"value": logged})
    assert (difference.field, difference.message) == ("value", message)


def test_of_parts_that_only_the_log_has_the_first_one_is_told():
    logged = {f"part {number}": number for number in range(20)}
    assert first_difference({}, logged).field == "part 0"


def test_a_whole_number_is_logged_of_a_float():
    assert first_difference(2.0, 2) is None


def test_a_list_of_another_length_differs_in_its_number_of_items():
    difference = first_difference({"path": [1, 2, 3, 4]}, {"path": [1, 2, 3]})
    assert (difference.field, difference.message) == ("path", "logged 3 items, computed 4 items")


def test_a_record_of_another_class_differs_in_its_class():
    difference = first_difference({"action": Steer(1.0)}, {"action": Turn(1.0)})
    assert (difference.field, difference.message) == ("action", "logged a Turn, computed a Steer")


def test_a_missing_part_is_the_same_as_none():
    assert first_difference({"estimate": None}, {}) is None
    assert (
        first_difference({"estimate": 1}, {}).message
        == "the log has no value here, but one was computed"
    )

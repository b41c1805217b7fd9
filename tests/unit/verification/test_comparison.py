"""The comparison of a logged record with the same record computed again."""

import numpy as np
import pytest

from tetractl.core.commands import Steer, Turn
from tetractl.verification.comparison import first_difference


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
    assert first_difference({"estimate": 1}, {}).message == "logged nothing, computed a value"

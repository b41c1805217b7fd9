"""The comparison of a logged record with the same record computed again."""

import numpy as np
import pytest

from tetractl.verification.comparison import first_difference


@pytest.mark.parametrize(
    ("ours", "logged", "message"),
    [
        (1.5, "1.5", "logged '1.5', computed 1.5"),
        (np.zeros(2), "0 0", "logged str, computed ndarray"),
        ("0 0", np.zeros(2), "logged ndarray, computed str"),
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

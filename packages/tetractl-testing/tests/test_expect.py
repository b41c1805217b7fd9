"""Tests of the comparisons that checks use, and of the problems that they report."""

import math
import random

import numpy as np
import pytest
from tetractl_testing.expect import (
    Finding,
    expect,
    expect_near,
    expect_same,
    expect_true,
    findings_of,
    random_watched,
)

from tetractl.core.errors import UsageError


def problem_of(check, *args):
    """The problem of the one thing that a check expects."""
    (finding,) = findings_of(lambda: check("it", *args))
    assert finding.what == "it"
    return finding.problem


@pytest.mark.parametrize(
    ("ours", "theirs", "scale", "problem"),
    [
        ([1.0, 2.0], [1.0, 2.0], 1.0, ""),
        ([1.0, 2.0], [1.0, 2.05], 1.0, ""),
        ([1.0, 2.0], [1.0, 2.2], 1.0, "2 and 2.2 in case 1 of 2"),
        ([1.0, 2.0], [1.0, 2.2], 10.0, ""),
        ([1.5, 2.0], [1.0, 2.2], [1.0, 1.0], "1.5 and 1 in case 0 of 2"),
        ([-1.5], [-1.0], 1.0, "-1.5 and -1 in case 0 of 1"),
        ([math.nan, 2.0], [1.0, 2.0], 1.0, "nan and 1 in case 0 of 2"),
        ([1.0, 2.0], [1.0, math.inf], 1.0, "2 and inf in case 1 of 2"),
        ([0.0], [0.0], 0.0, ""),
    ],
)
def test_results_are_near_within_a_share_of_the_scale(ours, theirs, scale, problem):
    """Regression: a result that is no number passed, and hid the other cases."""
    assert problem_of(expect_near, ours, theirs, scale, 0.1) == problem


def test_the_first_case_that_is_not_good_is_named():
    assert problem_of(expect_true, [True, True]) == ""
    assert problem_of(expect_true, [True, False, False], "wrong") == "wrong in case 1 of 3"
    assert problem_of(expect_true, False) == "not so in case 0 of 1"


def test_the_same_bits_are_expected():
    assert problem_of(expect_same, [np.array([1.0, math.nan])], [np.array([1.0, math.nan])]) == ""
    assert problem_of(expect_same, [np.array([1.0])], [np.array([1.0 + 2**-52])]) != ""


def test_without_a_list_a_problem_is_raised_and_nothing_else():
    expect("it")
    with pytest.raises(AssertionError, match="it: is wrong"):
        expect("it", "is wrong")


def test_an_error_in_the_code_under_test_is_the_last_finding():
    def check():
        expect("first")
        raise ValueError("broken")

    first, last = findings_of(check)
    assert first == Finding("first")
    assert last.what == "runs"
    assert last.problem.endswith("ValueError: broken")
    assert "test_expect.py" in last.problem


def test_a_mistake_of_the_user_is_no_finding():
    def check():
        raise UsageError("no such thing")

    with pytest.raises(UsageError):
        findings_of(check)


def test_global_random_numbers_are_noticed():
    state = random.getstate(), np.random.get_state()  # noqa: NPY002
    try:
        with random_watched() as used:
            np.random.default_rng(1).normal()
        assert used == []
        with random_watched() as used:
            random.random()
        assert used == ["random"]
        with random_watched() as used:
            np.random.normal()  # noqa: NPY002
        assert used == ["numpy.random"]
    finally:
        random.setstate(state[0])
        np.random.set_state(state[1])  # noqa: NPY002

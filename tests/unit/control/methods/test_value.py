"""Tests of the value by which the candidates of a control step are compared."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.control.methods.value import PATIENCE_S, CandidateValues

AT_FIRST = CandidateValues(10.0, 0.0, 0.2)


def test_a_plan_under_way_is_worth_its_error_and_the_price_of_its_time():
    value = AT_FIRST.plan_value(3.0, 5, is_new=False)
    assert value == pytest.approx(3 + 10 * CandidateValues.time_price)


def test_a_new_attempt_is_worth_the_accepted_error_which_doubles():
    late = CandidateValues(10.0, 2 * PATIENCE_S, 0.2)
    time = 10 * CandidateValues.time_price
    assert AT_FIRST.plan_value(0.0, 5, is_new=True) == pytest.approx(10 + time)
    assert late.plan_value(0.0, 5, is_new=True) == pytest.approx(40 + time)
    assert late.plan_value(0.0, 5, is_new=False) == pytest.approx(time)
    impatient = CandidateValues(10.0, PATIENCE_S, 0.2, PATIENCE_S / 2)
    assert impatient.plan_value(0.0, 5, is_new=True) == pytest.approx(40 + time)


def test_caution_costs_as_much_as_errors_in_units_of_the_accepted_one():
    plain = AT_FIRST.plan_value(3.0, 5, is_new=False)
    assert AT_FIRST.plan_value(3.0, 5, False, touches=True) == pytest.approx(
        plain + 10 * CandidateValues.touch_penalty
    )


POSITIVE = st.floats(0.01, 100)


@given(POSITIVE, POSITIVE, POSITIVE, POSITIVE, POSITIVE, st.integers(1, 90), st.booleans())
def test_the_value_is_that_of_the_formula(
    accept, spent_s, period_s, patience_s, error, length, new
):
    values = CandidateValues(accept, spent_s, period_s, patience_s + 5)
    attempt = accept * 2 ** (spent_s / (patience_s + 5)) if new else 0.0
    price = accept * CandidateValues.time_price * length * period_s
    plain = values.plan_value(error, length, new)
    assert plain == pytest.approx(error + attempt + price)
    touching = values.plan_value(error, length, new, touches=True)
    assert touching - plain == pytest.approx(accept * CandidateValues.touch_penalty, rel=1e-6)
    assert values.plan_value(error, length + 1, new) > plain

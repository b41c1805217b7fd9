"""Tests of restarting filters if the model of robots on wheels does not fit."""

import numpy as np
import pytest
from testkit.paths import ROOT

from tetractl.control.estimation.filter import FilterBank
from tetractl.control.estimation.filter_start import first_std, reopened_bank
from tetractl.control.estimation.kernels.filter_state import LN_A, SIDE
from tetractl.spec.load import load_spec

THREE_ROBOTS = ROOT / "experiments/three_m3pi.yaml"
NO_LIMIT = 0
"""Number of the group of filters whose motors do not saturate."""
FIRST_SLOT = 0
"""Slot of the only hypothesis of a filter that begins."""


def filters_of_slow_turns():
    """Filters that have found a to be 30 % less than the prior's, and a side, both to 3 %."""
    spec = load_spec(THREE_ROBOTS).experiment
    prior = spec.controller.prior.of(spec.controller.problem(spec.setup), 0.0, spec.setup)
    filters = FilterBank(prior)
    for state, found in ((LN_A, np.log(0.7)), (SIDE, 0.1)):
        filters.bank.state[..., state] = found
        filters.bank.cov[:, :, FIRST_SLOT, state, state] = 0.03**2
    return filters


def opened_again(filters):
    return reopened_bank(filters.bank, filters.likeliest(), False, filters.prior)


def test_motors_of_all_robots_may_saturate_where_one_heading_does_not_fit():
    """Regression: robots that just saturate do not show it by a misfit: their a was found 14 to
    25 % too small, by 8 to 15 deviations."""
    bank = opened_again(filters_of_slow_turns())
    limited = bank.group != NO_LIMIT
    assert limited.any(axis=0).all()
    assert np.isfinite(bank.score[limited]).all()


@pytest.mark.parametrize("state", [LN_A, SIDE])
def test_what_was_found_of_turns_without_a_limit_is_forgotten_with_one(state):
    """Regression: a began from the small value that had explained slow turns, and stayed small."""
    filters = filters_of_slow_turns()
    bank = opened_again(filters)
    limited = bank.group != NO_LIMIT
    assert bank.state[limited, FIRST_SLOT, state] == pytest.approx(0.0)
    deviations = np.sqrt(bank.cov[:, :, FIRST_SLOT, state, state])
    of_prior = np.broadcast_to(first_std(filters.prior)[:, state], limited.shape)
    assert deviations[limited] == pytest.approx(of_prior[limited])

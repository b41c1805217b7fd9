"""How the filters of `tetractl.control.filter` begin: with a trial, with robots that were replaced,
and when the model of robots on wheels turns out not to fit.

Each robot gets one filter for each dead time of a grid around the prior's,

    tau = tau_prior - reach, ... in steps of GRID.step_s ..., tau_prior + reach [s],

and not below 0, where the reach is GRID.reach standard deviations. There is one such grid for each
*group*, in which the filters start from the same value of one state that cannot be found from any
start (`body_model`): a cell's groups try several frequencies of its helix; robots on wheels have
one group at first, and one more for each saturation of motors that is tried later.

Arrays are those of a `Bank`: B filters, group by group, of N robots.
"""

import numpy as np

from tetractl.control.body_model import SATURATION_STD, BodyModel, first_std
from tetractl.control.kernels.filter_state import GRID, LN_A, LN_SATURATION, SIDE, STATES, Bank
from tetractl.control.prior import Prior
from tetractl.core.poses import Bools, Floats, Integers

LN_SATURATES = -3.0
"""ln of the probability of motors that saturate, before frames show it: 5 %."""
CHANGE_STD_S = 0.05
"""Standard deviation of the change of a dead time during a trial [s]; chosen, not measured."""
FIRST_SLOT = 0
"""The slot of the only hypothesis that a filter begins with."""


def first_bank(prior: Prior, body: BodyModel) -> Bank:
    """Return the filters from which a trial begins: of robots that stand, in unknown poses."""
    dead_times_s = _dead_times(prior)
    std = first_std(prior, body)
    groups: list[Bank] = []
    for number, tried in enumerate(body.first_tried):
        mean = np.zeros((len(dead_times_s), len(prior.a), STATES))
        mean[..., body.tried] = tried
        groups.append(Bank.start(dead_times_s, mean, std, _numbers(number, dead_times_s)))
    return Bank.joined(groups)


def bank_with_replaced(bank: Bank, first: Bank, replaced: Bools) -> Bank:
    """Return a bank in which the robots `replaced` (N,) have the filters of the bank `first`."""
    size = max(len(bank.score), len(first.score))
    bank = bank.padded(size)
    first = first.padded(size)
    for column, first_column in zip(bank, first, strict=True):
        column[:, replaced] = first_column[:, replaced]
    return bank


def reopened_bank(
    bank: Bank,
    likeliest: tuple[Integers, Integers, Integers],
    heading_fits: bool,
    prior: Prior,
    body: BodyModel,
) -> Bank:
    """Return filters that find out why the model does not fit: with the first dead times again, as
    the dead time may have changed, and its filter be gone; and, unless `heading_fits` of every
    robot, in groups with motors that saturate.

    All know what each robot's `likeliest` hypothesis does, by its index (filters, robots and slots,
    (N,) each). It stays the likeliest until frames show otherwise: filters of other dead times
    score less by how much these differ, those with saturation by what is rare. All robots get the
    latter: one that just saturates does not show it by a misfit. How well each fits is tested from
    the start again.
    """
    unchanged = _around_likeliest(bank, likeliest, prior, body)
    if heading_fits:
        return unchanged
    std = first_std(prior, body)
    groups = [unchanged]
    for number, ln_saturation in enumerate(body.later_tried, 1):
        groups.append(_saturating(unchanged, number, ln_saturation, std))
    return Bank.joined(groups)


def _dead_times(prior: Prior) -> Floats:
    """Return the grid of dead times to begin with [s]."""
    reach_s = GRID.reach * prior.dead_time_std
    least_s = max(0.0, prior.dead_time - reach_s)
    return np.arange(least_s, prior.dead_time + reach_s + 1e-9, GRID.step_s)


def _numbers(group: int, dead_times_s: Floats) -> Integers:
    """Return the number of a group for each of its filters."""
    return np.full(len(dead_times_s), group)


def _around_likeliest(
    bank: Bank,
    likeliest: tuple[Integers, Integers, Integers],
    prior: Prior,
    body: BodyModel,
) -> Bank:
    """Return a group of filters that all start from each robot's likeliest hypothesis.

    A dead time that differs by d from the likeliest one has the score -(d / CHANGE_STD_S)^2 / 2.
    """
    filters, robots, _ = likeliest
    dead_times_s = _dead_times(prior)
    mean = np.repeat(bank.state[likeliest][None], len(dead_times_s), axis=0)
    group = Bank.start(dead_times_s, mean, first_std(prior, body), _numbers(0, dead_times_s))
    group.cov[:, :, FIRST_SLOT] = bank.cov[likeliest]
    group.noise_scale[:] = bank.noise_scale[filters, robots]
    difference_s = group.dead_time_s - bank.dead_time_s[filters, robots]
    group.score[:] = -((difference_s / CHANGE_STD_S) ** 2) / 2
    return group


def _saturating(unchanged: Bank, number: int, ln_saturation: float, std: Floats) -> Bank:
    """Return the group of this number: a copy of the unchanged one, with motors that saturate.

    Without this limit, filters have explained slow turns by a small turning rate a, and by a side,
    and are sure of them. So both are forgotten: they are those of the prior again, with its
    deviations `std` (N, n).
    """
    group = unchanged.copied()
    group.group[:] = number
    for state in (LN_A, SIDE):
        group.state[..., state] = 0.0
        _set_uncertain(group, state, std[:, state])
    group.state[..., LN_SATURATION] = ln_saturation
    _set_uncertain(group, LN_SATURATION, SATURATION_STD)
    group.score[:] += LN_SATURATES
    return group


def _set_uncertain(bank: Bank, state: int, std: Floats | float) -> None:
    """Let a state have a standard deviation, (N,) or that of all robots, and depend on no other."""
    bank.cov[..., state, :] = 0.0
    bank.cov[..., state] = 0.0
    bank.cov[:, :, FIRST_SLOT, state, state] = std**2

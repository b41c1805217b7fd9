"""The sets of filters with which the estimation of the robots' motion starts, or starts again.

This module contains the assumptions about robots on wheels and about cells. It creates three banks
for `tetractl.control.estimation.filter`: the bank at the start of a trial, the bank after robots
were replaced by others, and the bank after the model has turned out not to fit robots on wheels.

In addition to the states that all robots have, each kind of robot has some of its own. For some of
these, one starting value is not enough to find the true value. Then several values are *tried*, for
one state at a time: the filters are laid out in groups, and each group starts from a different
value of this state. For cells, the state is the frequency of the helix on which they swim. For
robots on wheels, the state is first the lag of the wheels: 0, and lags LAG_STEP_S apart around the
given one. Later, if the heading does not fit, the state is the saturation of the motors: one group
has none, and there is one more group for each saturation that is tried.

In each group, a robot gets one filter for each dead time of a grid around the prior's dead time,

    tau = tau_prior - reach, ... in steps of GRID_STEP_S ..., tau_prior + reach [s],

and not below 0. The reach is GRID_REACH standard deviations.

Arrays have the layout of a `Bank`: B filters, group by group, for N robots.
"""

import math
from typing import NamedTuple

import numpy as np

from tetractl.control.estimation.kernels.filter_state import (
    FLOW_X,
    FLOW_Y,
    GRID_STEP_S,
    HEADING,
    HELIX_COSINE,
    HELIX_SINE,
    LAG,
    LN_A,
    LN_FREQUENCY,
    LN_SATURATION,
    LN_SPEED,
    MARKER_BIAS,
    SIDE,
    STATES,
    STATES_OF_CELLS,
    STATES_OF_WHEELS,
    TURN_BIAS,
    Bank,
    FilterModel,
    X,
    Y,
)
from tetractl.control.estimation.prior import Prior
from tetractl.core import elementwise
from tetractl.core.elementary import log
from tetractl.core.poses import Bools, Floats, Integers
from tetractl.model.motion.motion import in_rows

# The usual noise of a camera, and the random walks of a robot's states, per sqrt(s). Chosen once by
# trials; docs/decisions/filter.md has the errors measured with them.
POSITION_NOISE_S = 0.005
"""Standard deviation of a measured position, divided by the robot's speed [s].

Used if the spec does not give the camera's noise.
"""
HEADING_NOISE = 0.01
"""Standard deviation of a measured heading [rad].

Used if the spec does not give the camera's noise.
"""
SLIP = 0.02
"""Random walk of the position, divided by the robot's speed [s per sqrt(s)]."""
WALK = 0.1
"""Random walk of the heading at the start of a trial [rad/sqrt(s)]."""
A_WALK = 0.01
"""Random walk of the logarithm of the turning rate a [1/sqrt(s)]."""
SPEED_WALK = 0.005
"""Random walk of the logarithm of the speed [1/sqrt(s)]."""
SIDE_WALK = 0.005
"""Random walk of `side`, by which left and right turns differ [1/sqrt(s)].

`tetractl.model.motion.turn_rate` defines this state.
"""
SATURATION_WALK = 0.02
"""Random walk of the logarithm of the motors' saturation, once it is tried [1/sqrt(s)]."""
TURN_BIAS_WALK = 0.005
"""Random walk of the turn bias [rad/sqrt(s)]."""
MARKER_BIAS_WALK = 0.002
"""Random walk of the marker bias [rad/sqrt(s)]."""
FLOW_WALK = 0.05
"""Random walk of the flow, as a multiple of its prior standard deviation [1/sqrt(s)]."""
HELIX_WALK = 0.1
"""Random walk of the helix's sine and cosine, as a multiple of its radius [1/sqrt(s)]."""
FREQUENCY_WALK = 0.01
"""Random walk of the logarithm of the helix's frequency [1/sqrt(s)]."""
FREQUENCY_STD = 0.15
"""Prior standard deviation of the logarithm of the helix's frequency in each filter."""
GRID_REACH = 3.0
"""Half width of the grid of dead times at first, in standard deviations of the prior."""
SPEED_MIN = 1e-9
"""Minimum speed used to scale a noise [length unit/s], because a robot's speed may be 0."""
FREQUENCIES = 0.5, 0.75, 1.0, 1.4
"""Frequencies of the helix with which filters start, as multiples of the usual frequency.

Neighbouring values differ by a factor of at most 1.5.
"""
SATURATIONS = 0.8, 0.4
"""Saturations of the motors that are tried if the heading of a robot does not fit the model."""
SATURATION_STD = 0.3
"""Prior standard deviation of the logarithm of the saturation, around each of SATURATIONS."""
LAG_STEP_S = 0.05
"""Distance between the lags of the wheels to start from [s]."""
LAG_MAX_S = 0.3
"""Maximum lag of the wheels to start from [s]. A given lag may be longer."""
LAG_PRIOR_STD_S = 0.1
"""Standard deviation of the lag of the wheels around the given one [s]."""
GROUPS_MAX = max(len(FREQUENCIES), 1 + len(SATURATIONS), 2 + round(LAG_MAX_S / LAG_STEP_S))
"""Maximum number of groups of filters that a robot has."""
LN_SATURATION_PRIOR = -3.0
"""Logarithm of the prior probability that a robot's motors saturate: about 5 %."""
DEAD_TIME_CHANGE_STD_S = 0.05
"""Standard deviation of the change of the dead time during a trial [s]. Chosen, not measured."""
FIRST_SLOT = 0
"""Index of the only hypothesis with which a filter starts."""


# ---- what is assumed ----


class TriedState(NamedTuple):
    """A state, such as the lag of the wheels, for which filters try several starting values."""

    state: int
    """Index of the tried quantity in the state of a filter."""
    same: float
    """Difference of two groups' values of this state below which the groups merge."""


TRIED_FREQUENCIES = TriedState(LN_FREQUENCY, same=0.05)
TRIED_SATURATIONS = TriedState(LN_SATURATION, same=0.05)
TRIED_LAGS = TriedState(LAG, same=0.0)
"""The lag of the wheels as a tried state.

It never changes in a filter, so groups never merge.
"""


def first_tried_state(prior: Prior) -> TriedState:
    """Return the state for which several starting values are tried when a trial begins.

    It is the logarithm of the helix's frequency for cells, and the lag of the wheels for other
    robots.
    """
    return TRIED_FREQUENCIES if prior.swims else TRIED_LAGS


def first_lags(prior: Prior) -> list[float]:
    """Return the lags of the wheels with which filters start [s].

    If the lag is certain, the list contains only the given lag. Otherwise the lags lie LAG_STEP_S
    apart around the given one, up to LAG_MAX_S, and include 0.
    """
    if not prior.lag_is_learnt:
        return [prior.lag]
    n_below = math.floor(prior.lag / LAG_STEP_S + 1e-9)
    n_above = max(0, math.floor((LAG_MAX_S - prior.lag) / LAG_STEP_S + 1e-9))
    lags_s = [prior.lag + LAG_STEP_S * k for k in range(-n_below, n_above + 1)]
    return lags_s if lags_s[0] < LAG_STEP_S / 2 else [0.0, *lags_s]


def filter_model(prior: Prior) -> FilterModel:
    """Return the assumptions that filters make about the robots of a prior.

    At first, the motors of wheels are assumed not to saturate.
    """
    _, walk = _deviations(prior)
    walk[X] = SLIP * prior.speed
    walk[Y] = SLIP * prior.speed
    walk[HEADING] = WALK
    return FilterModel(
        parameters=in_rows(prior),
        noise=_measurement_std(prior),
        walk=walk,
        helix_rad_s=2 * math.pi * prior.helix_frequency if prior.swims else 0.0,
        host_lag_s=prior.lag,
        watchdog_s=prior.watchdog,
        sticks=prior.sticks,
        coarse=prior.coarse,
    )


def first_std(prior: Prior) -> Floats:
    """Return the starting standard deviations (N, n) of the n states that have a variance.

    The deviations of the pose are 0 until a frame provides the pose.
    """
    std, _ = _deviations(prior)
    return std.T


def _deviations(prior: Prior) -> tuple[Floats, Floats]:
    """Return starting standard deviations (n, N) of states, and their random walks [1/sqrt(s)].

    The deviations of the poses are 0, because poses start from a frame. A state that is known
    exactly does not walk. If the phase of a helix is random, sine and cosine deviate by the radius
    of the helix divided by sqrt(2).
    """
    flow = (prior.flow_std, FLOW_WALK * prior.flow_std)
    deviations = {
        LN_A: (prior.a_std, A_WALK),
        LN_SPEED: (prior.speed_std, SPEED_WALK),
        SIDE: (prior.side_std, SIDE_WALK),
        TURN_BIAS: (prior.heading_bias_std, TURN_BIAS_WALK),
        MARKER_BIAS: (prior.marker_bias_std, MARKER_BIAS_WALK),
        FLOW_X: flow,
        FLOW_Y: flow,
    }
    if prior.swims:
        swing = (prior.helix_radius / math.sqrt(2), HELIX_WALK * prior.helix_radius)
        deviations[HELIX_SINE] = swing
        deviations[HELIX_COSINE] = swing
        deviations[LN_FREQUENCY] = (FREQUENCY_STD, FREQUENCY_WALK)
    std = np.zeros((STATES_OF_CELLS if prior.swims else STATES_OF_WHEELS, len(prior.a)))
    walk = np.zeros_like(std)
    for state, (deviation, drift) in deviations.items():
        std[state] = deviation
        walk[state] = drift if deviation > 0 else 0.0
    return std, walk


def _measurement_std(prior: Prior) -> Floats:
    """Return the standard deviations (3, N) of measured x, y and heading.

    They consist of the camera's noise, or a usual value if the noise is not known, and of the
    rounding error of a camera that measures on a grid.
    """
    noise = np.empty((3, len(prior.a)))
    position = prior.position_noise
    noise[:2] = position or POSITION_NOISE_S * np.maximum(prior.speed, SPEED_MIN)
    noise[2] = prior.heading_noise or HEADING_NOISE
    camera_std = np.array(prior.pose_std)
    return elementwise.hypot(noise, camera_std[:, None])


# ---- the banks ----


def first_bank(prior: Prior) -> Bank:
    """Create the filters for the beginning of a trial.

    Robots stand still, and their poses are unknown.
    """
    dead_times_s = _dead_times(prior)
    std = first_std(prior)
    tried = first_tried_state(prior)
    first_values = [log(factor) for factor in FREQUENCIES] if prior.swims else first_lags(prior)
    groups: list[Bank] = []
    for group_index, value in enumerate(first_values):
        mean = np.zeros((len(dead_times_s), len(prior.a), STATES))
        mean[..., LAG] = prior.lag
        mean[..., tried.state] = value
        group = Bank.start(dead_times_s, mean, std, _group_indices(group_index, dead_times_s))
        group.score[:] = -np.square((mean[:, :, LAG] - prior.lag) / LAG_PRIOR_STD_S) / 2
        groups.append(group)
    return Bank.joined(groups)


def bank_with_replaced(bank: Bank, prior: Prior, replaced: Bools) -> Bank:
    """Return the filters after some robots were replaced: these robots' filters start again.

    Args:
        bank: The bank so far, which stays unchanged.
        prior: The prior of all robots.
        replaced: Whether each robot was replaced, (N,).
    """
    start_bank = first_bank(prior)
    size = max(len(bank.score), len(start_bank.score))
    bank = bank.padded(size)
    for column, start_column in zip(bank, start_bank.padded(size), strict=True):
        column[:, replaced] = start_column[:, replaced]
    return bank


def reopened_bank(
    bank: Bank, likeliest: tuple[Integers, Integers, Integers], heading_fits: bool, prior: Prior
) -> Bank:
    """Create filters that search for the reason why the model does not fit.

    The filters start with all dead times again, because the dead time may have changed after its
    filter was dropped. Unless every heading fits, there are also groups with motors that saturate.
    All robots get these groups, because a robot whose motors only just saturate is not visible as a
    misfit.

    Every filter starts from the robot's likeliest hypothesis so far. That hypothesis stays the
    likeliest until frames show otherwise: filters with other dead times score less the more these
    differ, and filters with saturation score less because saturation is rare. The test of how well
    each filter fits starts from zero.

    Args:
        bank: The filters so far.
        likeliest: Where each robot's likeliest hypothesis is in the bank: its filter, robot and
            slot, (N,) each.
        heading_fits: Whether the heading of every robot fits the model.
        prior: The prior of all robots.
    """
    std = first_std(prior)
    base_group = _around_likeliest(bank, likeliest, prior, std)
    groups = [base_group]
    if not heading_fits:
        for group_index, saturation in enumerate(SATURATIONS, 1):
            groups.append(_saturating(base_group, group_index, log(saturation), std))
    return Bank.joined(groups)


def _dead_times(prior: Prior) -> Floats:
    """Return the grid of dead times with which filters start [s]."""
    reach_s = GRID_REACH * prior.dead_time_std
    dead_time_min_s = max(0.0, prior.dead_time - reach_s)
    return np.arange(dead_time_min_s, prior.dead_time + reach_s + 1e-9, GRID_STEP_S)


def _group_indices(group: int, dead_times_s: Floats) -> Integers:
    """Return an array that contains the index of a group once for each of its filters.

    A group has one filter for each of its dead times.
    """
    return np.full(len(dead_times_s), group)


def _around_likeliest(
    bank: Bank, likeliest: tuple[Integers, Integers, Integers], prior: Prior, std: Floats
) -> Bank:
    """Create filters that all start from the most probable state of each robot.

    A dead time that differs by d from the likeliest one gets the score -(d /
    DEAD_TIME_CHANGE_STD_S)^2 / 2.
    """
    filters, robots, _ = likeliest
    dead_times_s = _dead_times(prior)
    mean = np.repeat(bank.state[likeliest][None], len(dead_times_s), axis=0)
    group = Bank.start(dead_times_s, mean, std, _group_indices(0, dead_times_s))
    group.cov[:, :, FIRST_SLOT] = bank.cov[likeliest]
    group.noise_scale[:] = bank.noise_scale[filters, robots]
    difference_s = group.dead_time_s - bank.dead_time_s[filters, robots]
    group.score[:] = -np.square(difference_s / DEAD_TIME_CHANGE_STD_S) / 2
    return group


def _saturating(base_group: Bank, group_index: int, ln_saturation: float, std: Floats) -> Bank:
    """Copy a group of filters as group `group_index`, with motors that saturate.

    Without saturation, filters have explained slow turns by a small turning rate a and by a
    difference between the sides, and have become sure of both. The copy therefore forgets both:
    they get the values and the deviations `std` (N, n) of the prior again.
    """
    group = base_group.copied()
    group.group[:] = group_index
    for state in (LN_A, SIDE):
        group.state[..., state] = 0.0
        _set_uncertain(group, state, std[:, state])
    group.state[..., LN_SATURATION] = ln_saturation
    _set_uncertain(group, LN_SATURATION, SATURATION_STD)
    group.score[:] += LN_SATURATION_PRIOR
    return group


def _set_uncertain(bank: Bank, state: int, std: Floats | float) -> None:
    """Give a state a new standard deviation, and remove its correlation with all other states.

    `std` is one number for each robot (N,), or one number for all of them. `bank` changes in
    place.
    """
    bank.cov[..., state, :] = 0.0
    bank.cov[..., state] = 0.0
    bank.cov[:, :, FIRST_SLOT, state, state] = np.square(std)

"""A readable reference in whole arrays for the kernel `control.estimation.kernels.bank`."""

import math

import numpy as np

from tetractl.control.estimation.filter import FilterBank
from tetractl.control.estimation.filter_start import LAG_STEP_S
from tetractl.control.estimation.kernels.filter_state import (
    FINEST_STEP_S,
    LAG,
    LEAST_BLOCKS,
    LN_A,
    LN_SPEED,
    MARKER_BIAS,
    OWN_PROBABILITY,
    OWN_STD_S,
    QUANTILE,
    SIDE,
    TURN_BIAS,
)
from tetractl.core.motion_estimate import Estimate
from tetractl.core.poses import Floats


def share(filters: FilterBank) -> tuple[Floats, Floats, Floats]:
    """Return the ln of each filter's probability (B, N), up to a constant, by its own frames and by
    what those of the other robots tell of the common dead time; and each robot's dead time and its
    standard deviation (N,) [s], by the filters with the lag of its likeliest one.
    """
    bank = filters.bank
    prior = filters.prior
    steps = bank.step_s[0]
    finest = FINEST_STEP_S
    times = np.arange(0, float(bank.dead_time_s.max()) + finest, finest / 2)
    gaps = times[:, None, None] - bank.dead_time_s
    width = np.maximum(steps, finest) / 2
    near = (1 - OWN_PROBABILITY) * np.exp(-((gaps / width) ** 2) / 2) / width
    near += OWN_PROBABILITY * np.exp(-((gaps / OWN_STD_S) ** 2) / 2) / OWN_STD_S
    ln = np.log((near * np.exp(bank.score)).sum(axis=1) + 1e-300)  # of each robot's frames
    ln_prior = -(((times - prior.dead_time) / prior.dead_time_std) ** 2) / 2
    ln_all = ln.sum(axis=1) + ln_prior
    ln_others = ln_all[:, None] - ln
    by_others = (near * np.exp(ln_others - ln_others.max(axis=0))[:, None]).sum(axis=0)
    score = bank.score + np.log(by_others + 1e-300)
    weight = np.exp(score - score.max(axis=0))
    lag = bank.state[:, :, 0, LAG]
    best = score.argmax(axis=0)
    weight *= lag == lag[best, np.arange(len(best))]  # of filters with the likeliest one's lag
    weight /= weight.sum(axis=0)
    mean = (weight * bank.dead_time_s).sum(axis=0)
    spread = (weight * (bank.dead_time_s - mean) ** 2).sum(axis=0)
    return score, mean, np.sqrt(spread + (steps / 4) ** 2)


def estimate(filters: FilterBank) -> Estimate:
    """Return the parameters of the robots by their likeliest hypotheses, and their standard
    deviations, which grow by what the test of the innovations finds."""
    score, tau, tau_std = share(filters)
    bank = filters.bank
    prior = filters.prior
    best = np.argmax(score, axis=0), np.arange(score.shape[1])
    ln_weight = bank.ln_weight[best]
    likeliest = (*best, np.argmax(ln_weight, axis=1))
    z = bank.state[likeliest]
    cov = bank.cov[likeliest]
    weights = np.exp(ln_weight - ln_weight.max(axis=1, keepdims=True))
    squares = bank.square_sum[best]
    blocks = np.maximum(bank.blocks[best], LEAST_BLOCKS)[:, None]
    more = np.sqrt(np.maximum(1, squares / blocks)).max(axis=1)
    std = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), 0.0)) * more[:, None]
    a = prior.a * np.exp(z[:, LN_A])
    speed = prior.speed * np.exp(z[:, LN_SPEED])
    of_bias = cov[:, [TURN_BIAS, MARKER_BIAS]][:, :, [TURN_BIAS, MARKER_BIAS]].sum(axis=(1, 2))
    part = 2 / (9 * blocks)
    lag = lag_std = None
    if prior.lag_is_learnt:
        probability = np.exp(score - score.max(axis=0))
        probability /= probability.sum(axis=0)
        lags = bank.state[:, :, 0, LAG]
        lag = z[:, LAG]
        lag_std = np.sqrt((probability * (lags - lag) ** 2).sum(axis=0) + (LAG_STEP_S / 4) ** 2)
    return Estimate(
        a=a,
        a_std=a * std[:, LN_A],
        speed=speed,
        speed_std=speed * std[:, LN_SPEED],
        heading_bias=z[:, TURN_BIAS] + z[:, MARKER_BIAS],
        heading_bias_std=np.sqrt(np.maximum(of_bias, 0.0)) * more,
        side=z[:, SIDE],
        side_std=std[:, SIDE],
        saturation=np.ones(len(a)),
        stands=weights[:, -1] / weights.sum(axis=1),
        lag=lag,
        lag_std=lag_std,
        dead_time=float(tau.mean()),
        dead_time_std=math.sqrt(np.mean((tau_std * more) ** 2) + np.var(tau)),
        own_dead_time=tau,
        own_dead_time_std=tau_std,
        misfit=squares / (blocks * (1 - part + QUANTILE * np.sqrt(part)) ** 3),
    )

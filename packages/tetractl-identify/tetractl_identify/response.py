"""Fits how robots on two wheels follow commands of speed v and turning rate w.

**Model.** A command acts `dead_time` after it is sent. The robot's speed p(t) and turning rate q(t)
follow the command with first-order lags of their own. From one pose to the next, a robot

    turns by   turning_gain * integral of q  +  veer * integral of p  +  a random walk's step
    drives     speed_gain * integral of p    +  a term in q          +  a random walk's step

along its heading. Poses are measured with white noise. Two neighbouring steps share the noise of
the pose between them, with opposite signs, so the covariance of the steps is tridiagonal. Commands
and poses may have different clocks. Their times then drift apart at the rate `clock_drift`, and the
dead time is the one in the middle of the recording.

**Fit.** `choose_steps` chooses the steps of a robot, and the delay at which the search starts. From
a grid around this delay, `_search` finds the parameters with the most likely regression of the
steps (`step_regression`). Intervals are normal in the dead time, the gains and the logarithms of
the other parameters. They are as wide as the differences between blocks of BLOCK_S require, because
the gains of real robots wander over seconds, and white noise and random walks do not describe this.

**Check.** If the commands explain less than half of a robot's motion, there are no values
(`explain_steps`). Unusual values are printed, and named below the table (`unusual`).

Shapes: a robot has M steps that the fit uses. Pairs of integrals of a motion stand in columns:
first of p, then of q.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.optimize import minimize

from tetractl.core.poses import Floats
from tetractl.tools.likelihood import LOG_LIKELIHOOD_MIN, Z_95, SampleInterval, derivatives
from tetractl_identify.driven_steps import (
    DEAD_TIME_UNIT_S,
    UsedSteps,
    choose_steps,
    driven_track,
    integrals_of,
)
from tetractl_identify.explained import assign_windows, explain_steps, refuse_contradicted
from tetractl_identify.fit import widening_from_blocks
from tetractl_identify.heading_offset import heading_offset
from tetractl_identify.pose_steps import STD_OF_MEDIAN, robust_gains
from tetractl_identify.robot_response import SHORTEST_LAG_S, RobotResponse
from tetractl_identify.step_regression import ResponseParameters, whitened_turns, whitened_ways
from tetractl_identify.tracks import Track

CLIP = 3.0
"""Standard deviations at which residuals are clipped for a first estimate of the noise."""
GRID_DEAD_TIMES_S = np.arange(-0.25, 0.26, 0.05)
"""Dead times from which the search may start, relative to that of the start [s]."""
GRID_TURNING_LAGS_S = np.array([0.03, 0.1, 0.3])
"""Lags of turning from which it may start [s]; that of speed starts at its unit."""
LAG_UNIT_S = 0.1
"""Usual lag [s], in which lags are searched, as all parameters are in usual values."""
HEADING_WALK_UNIT = 0.02
"""Usual random walk of the heading [rad/sqrt(s)]."""
HEADING_NOISE_UNIT = 0.003
"""Usual noise of headings [rad]."""
WAY_WALK_UNIT = 0.02
"""Usual random walk of the distance in 1 s, relative to the speed."""
POSITION_NOISE_UNIT_S = 0.002
"""Usual noise of positions, relative to the speed [s]."""
GRADIENT = 1e-3
"""Slope of ln of the posterior, per unit of the parameters, at which the search ends."""
UNIT_LEAST = 0.02
"""Minimum of the unit of the parameters for the intervals, relative to the unit of the search."""
UNIT_STDS = 3.0
"""Unit of the parameters for the intervals: this many standard deviations.

It is limited to the range from UNIT_LEAST to 1 of the units of the search.
"""
SEARCHED = 8
"""Number of the parameters that are searched; behind them in a vector come the gains."""
PRIOR_STD = 5.0
"""Standard deviation of the prior of each parameter, in its units: hardly any prior."""
ONE_RATIO_STD = 0.3
"""Deviation of the gains, relative to them, if speed and turning rate are sent in one ratio."""
UNKNOWN = 5.0
"""Half width of the interval of a logarithm above which the data do not limit the value."""
UNKNOWN_S = 0.45
"""Half width of the interval of the dead time above which the data do not limit it [s].

It is nearly the half width that follows from the prior alone.
"""
RESOLVED_S = 1e-3
"""Standard deviation of times that no recording resolves [s]."""
RESOLVED_GAIN = 1e-3
"""Standard deviation of gains that no recording resolves.

Stamps are in ms, and a camera is calibrated to 0.1 % at best.
"""


def respond(tracks: Sequence[Track], dead_time: float = 0.1) -> list[RobotResponse]:
    """Fit how each robot of the tracks follows its commands.

    Args:
        tracks: Tracks of the same robots, with the speeds and turning rates that were sent.
        dead_time: The expected dead time [s]. If several dead times explain the motion, the nearest
            to this one is used.

    Raises:
        UsageError: If a robot drives too little, or if its commands explain less than half of its
            motion.
    """
    responses: list[RobotResponse] = []
    for robot, name in enumerate(tracks[0].names):
        driven = [driven_track(track, robot) for track in tracks]
        responses.append(_response(name, choose_steps(name, driven, dead_time)))
    sources = dict.fromkeys(source for track in tracks for source in track.sources)
    problems = [(response.name, response.problem) for response in responses if response.problem]
    refuse_contradicted(tuple(sources), problems)
    return responses


def _search(steps: UsedSteps, units: ResponseParameters) -> tuple[Floats, Floats]:
    """Find the most likely vector of parameters (8,), from the best starts of a grid.

    Returns:
        The vector, and approximately its standard deviations (8,).
    """

    def posteriors(vectors: Floats) -> Floats:
        """Compute the ln posterior (V,) of vectors (V, 8), with a normal prior around 0.

        It is UNLIKELY where it would not be finite.
        """
        scores = np.zeros(len(vectors))
        for i, vector in enumerate(vectors):
            parameters = units.scaled_by(vector)
            turns = whitened_turns(steps, parameters).restricted_likelihood()
            ways = whitened_ways(steps, parameters).restricted_likelihood()
            scores[i] = turns + ways - np.square(vector).sum() / (2 * PRIOR_STD**2)
        return np.where(np.isfinite(scores), scores, LOG_LIKELIHOOD_MIN)

    lags = np.log(GRID_TURNING_LAGS_S / LAG_UNIT_S)
    grid = list(product(GRID_DEAD_TIMES_S / DEAD_TIME_UNIT_S, lags))
    starts = np.zeros((len(grid), SEARCHED))
    starts[:, :2] = grid
    best = starts[posteriors(starts).argmax()]
    found = minimize(
        lambda vector: -posteriors(vector[None])[0], best, method="BFGS", options={"gtol": GRADIENT}
    )
    return found.x, np.sqrt(np.diag(found.hess_inv))


def _response(name: str, steps: UsedSteps) -> RobotResponse:
    """Fit one robot and return its values with their intervals."""
    driven = integrals_of(steps.tracks, steps.dead_time, LAG_UNIT_S)[steps.rows]
    heading_noise = _noise(steps, steps.turned, driven)
    position_noise = _noise(steps, steps.distance_along, driven)
    units = ResponseParameters(  # of a vector of zeros
        dead_time=steps.dead_time,
        turning_lag=LAG_UNIT_S,
        speed_lag=LAG_UNIT_S,
        heading_walk=HEADING_WALK_UNIT,
        way_walk=WAY_WALK_UNIT * steps.speed,
        heading_noise=max(HEADING_NOISE_UNIT, heading_noise),
        position_noise=max(POSITION_NOISE_UNIT_S * steps.speed, position_noise),
        clock_drift=steps.drift_unit,
    )
    vector, curvature_std = _search(steps, units)
    likeliest = units.scaled_by(vector)
    turn_gains = whitened_turns(steps, likeliest).gains()
    way_gains = whitened_ways(steps, likeliest).gains()
    likeliest_all = np.concatenate([vector, turn_gains, way_gains])
    std = _deviations(steps, units, likeliest_all, curvature_std)
    of_search = ResponseParameters(*std[:SEARCHED].tolist())  # in the units of the search
    veer_std, turning_std, speed_std = std[SEARCHED : SEARCHED + 3].tolist()
    if steps.in_one_ratio:
        veer_std = math.inf
        turning_std = math.hypot(turning_std, ONE_RATIO_STD * turn_gains[1])
        speed_std = math.hypot(speed_std, ONE_RATIO_STD * way_gains[0])

    # how much of the motion the commands explain
    driven = likeliest.integrals(steps)
    without_lags = replace(likeliest, turning_lag=SHORTEST_LAG_S, speed_lag=SHORTEST_LAG_S)
    sent = without_lags.integrals(steps)
    windows = assign_windows(steps.begin_s, steps.begin_s + steps.duration_s)
    turning_explained = explain_steps(
        steps.turned, driven @ turn_gains, sent[:, 1], likeliest.heading_noise, windows
    )
    distance_explained = explain_steps(
        steps.moved, driven @ way_gains, sent[:, 0], likeliest.position_noise, windows
    )
    clock_drift = None
    if steps.drift_unit:
        clock_drift = _normal(likeliest.clock_drift, steps.drift_unit * of_search.clock_drift)
    return RobotResponse(
        name=name,
        dead_time=_dead_time(likeliest.dead_time, DEAD_TIME_UNIT_S * of_search.dead_time),
        turning_lag=_lag_interval(likeliest.turning_lag, of_search.turning_lag),
        speed_lag=_lag_interval(likeliest.speed_lag, of_search.speed_lag),
        turning_gain=_normal(turn_gains[1], math.hypot(turning_std, RESOLVED_GAIN)),
        speed_gain=_normal(way_gains[0], math.hypot(speed_std, RESOLVED_GAIN)),
        veer=_normal(turn_gains[0], veer_std),
        heading_offset=heading_offset(steps.driven(driven), steps.in_one_ratio),
        heading_walk=_log_normal(likeliest.heading_walk, of_search.heading_walk),
        heading_noise=_log_normal(likeliest.heading_noise, of_search.heading_noise),
        way_walk=_log_normal(likeliest.way_walk, of_search.way_walk),
        position_noise=_log_normal(likeliest.position_noise, of_search.position_noise),
        clock_drift=clock_drift,
        turning_explained=turning_explained,
        distance_explained=distance_explained,
        duration_s=max(track.duration_s for track in steps.tracks),
        intervals=len(steps.rows),
        left_out=steps.left_out,
    )


def _noise(steps: UsedSteps, measured: Floats, driven: Floats) -> float:
    """Estimate the noise of poses from the correlation of neighbouring steps.

    The input is turns or distances (M,), and the integrals (M, 2) of the commands that cause them.
    """
    residuals = measured - driven @ robust_gains(measured, driven)
    limit = CLIP * STD_OF_MEDIAN * float(np.median(np.abs(residuals)))
    clipped = np.clip(residuals, -limit, limit)
    products = (clipped[1:] * clipped[:-1])[steps.neighbours]
    return math.sqrt(max(-float(products.mean()), 0.0)) if products.size else 0.0


def _deviations(
    steps: UsedSteps, units: ResponseParameters, likeliest: Floats, curvature_std: Floats
) -> Floats:
    """Compute the standard deviations (12,) of the most likely parameters, followed by the gains.

    The gains are those of turns and distances. Each deviation is the larger of two: one from the
    curvature of the likelihood, and one from the jackknife over B blocks. Let s_b and H_b be the
    slope and curvature of the ln likelihood of block b, and H the curvature of all blocks. Without
    block b, the most likely vector changes by about -(H - H_b)^-1 s_b.
    """
    at_best = units.scaled_by(likeliest[:SEARCHED])
    unit = np.ones(len(likeliest))
    unit[:SEARCHED] = np.clip(UNIT_STDS * curvature_std, UNIT_LEAST, 1.0)
    regressions = (whitened_turns(steps, at_best), whitened_ways(steps, at_best))
    of_gains = [np.diag(np.linalg.inv(whitened.information)) for whitened in regressions]
    unit[SEARCHED:] = np.sqrt(np.concatenate(of_gains))

    def of_blocks(changes: Floats) -> Floats:
        """Compute the ln likelihood of each block (B, V) after changes (1, V, 12) in units."""
        of_changes = []
        for values in likeliest + unit * changes[0]:
            parameters = units.scaled_by(values[:SEARCHED])
            turns = whitened_turns(steps, parameters).likelihoods(values[SEARCHED : SEARCHED + 2])
            ways = whitened_ways(steps, parameters).likelihoods(values[SEARCHED + 2 :])
            of_changes.append(np.bincount(steps.block, turns + ways))
        return np.column_stack(of_changes)

    size = len(likeliest)
    slopes, curvatures = derivatives(of_blocks, size)
    curvature = curvatures.sum(axis=0)
    of_prior = np.concatenate([whitened.prior[1] for whitened in regressions])
    curvature[range(SEARCHED, size), range(SEARCHED, size)] += of_prior * unit[SEARCHED:] ** 2
    inverse = _inverse(curvature)
    pulls = slopes @ inverse
    wider = widening_from_blocks(np.diagonal(curvatures, axis1=1, axis2=2))
    spread = len(pulls) * np.var(pulls, axis=0, ddof=1)
    variance = np.diag(inverse)
    return unit * np.sqrt(np.maximum(variance, wider**2 * spread))


def _inverse(curvature: Floats) -> Floats:
    """Invert a curvature (K, K). Eigenvalues count by their magnitudes, at least the prior's."""
    value, axes = np.linalg.eigh(curvature)
    return (axes / np.maximum(np.abs(value), PRIOR_STD**-2)) @ axes.T


def _normal(value: float, std: float) -> SampleInterval:
    """Create the 95 % interval of a normally distributed value with this standard deviation."""
    reach = Z_95 * std
    return SampleInterval(value, value - reach, value + reach)


def _dead_time(value: float, std: float) -> SampleInterval:
    """Create the interval of the dead time [s].

    Its ends are infinite if the data do not limit the dead time to within UNKNOWN_S.
    """
    if Z_95 * std > UNKNOWN_S:
        return SampleInterval(value, -math.inf, math.inf)
    return _normal(value, math.hypot(std, RESOLVED_S))


def _lag_interval(value: float, std: float) -> SampleInterval:
    """Create the interval of a lag [s] whose logarithm has this standard deviation.

    It begins at 0 if the lag is near its minimum, at most twice SHORTEST_LAG_S.
    """
    interval = _log_normal(value, math.hypot(std, RESOLVED_S / value))
    return replace(interval, low=0.0) if value <= 2 * SHORTEST_LAG_S else interval


def _log_normal(value: float, std: float) -> SampleInterval:
    """Create the interval of a value whose logarithm is normal with this standard deviation.

    It reaches from 0 to infinity if the logarithm is uncertain by more than UNKNOWN.
    """
    reach = Z_95 * std
    if reach > UNKNOWN:
        return SampleInterval(value, 0.0, math.inf)
    return SampleInterval(value, value * math.exp(-reach), value * math.exp(reach))

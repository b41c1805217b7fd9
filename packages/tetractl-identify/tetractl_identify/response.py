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
    integrate_over_tracks,
    select_driven_track,
)
from tetractl_identify.explained import assign_windows, explain_steps, refuse_contradicted
from tetractl_identify.fit import compute_block_widening
from tetractl_identify.heading_offset import fit_heading_offset
from tetractl_identify.pose_steps import STD_OF_MEDIAN, fit_robust_gains
from tetractl_identify.robot_response import LAG_MIN_S, RobotResponse
from tetractl_identify.step_regression import ResponseParameters, whiten_distances, whiten_turns
from tetractl_identify.tracks import Track

CLIP = 3.0
"""Standard deviations at which residuals are clipped for a first estimate of the noise."""
GRID_DEAD_TIMES_S = np.arange(-0.25, 0.26, 0.05)
"""Dead times from which the search may start, relative to the dead time of `choose_steps` [s]."""
GRID_TURNING_LAGS_S = np.array([0.03, 0.1, 0.3])
"""Lags of turning from which the search may start [s]. The lag of speed starts at LAG_UNIT_S."""
LAG_UNIT_S = 0.1
"""Usual lag [s]. The search expresses each parameter in its usual value."""
HEADING_WALK_UNIT = 0.02
"""Usual random walk of the heading [rad/sqrt(s)]."""
HEADING_NOISE_UNIT = 0.003
"""Usual noise of headings [rad]."""
DISTANCE_WALK_UNIT = 0.02
"""Usual random walk of the distance in 1 s, relative to the speed."""
POSITION_NOISE_UNIT_S = 0.002
"""Usual noise of positions, relative to the speed [s]."""
GRADIENT_MAX = 1e-3
"""Slope of ln of the posterior, per unit of the parameters, at which the search ends."""
STEP_SIZE_MIN = 0.02
"""Minimum of the unit of the parameters for the intervals, relative to the unit of the search."""
STEP_SIZE_STDS = 3.0
"""Unit of the parameters for the intervals: this many standard deviations.

It is limited to the range from STEP_SIZE_MIN to 1 of the units of the search.
"""
SEARCHED_COUNT = 8
"""Number of parameters that are searched. In a vector of all parameters, the gains follow them."""
PRIOR_STD = 5.0
"""Standard deviation of the prior of each parameter, in its units: hardly any prior."""
ONE_RATIO_GAIN_STD = 0.3
"""Relative standard deviation of the gains if speed and turning rate are sent in one ratio."""
UNKNOWN = 5.0
"""Half width of the interval of a logarithm above which the data do not limit the value."""
UNKNOWN_S = 0.45
"""Half width of the interval of the dead time above which the data do not limit it [s].

It is nearly the half width that follows from the prior alone.
"""
TIME_RESOLUTION_S = 1e-3
"""Standard deviation of times that no recording resolves [s]."""
GAIN_RESOLUTION = 1e-3
"""Standard deviation of gains that no recording resolves.

Stamps are in ms, and a camera is calibrated to 0.1 % at best.
"""


def fit_responses(tracks: Sequence[Track], dead_time: float = 0.1) -> list[RobotResponse]:
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
        driven_tracks = [select_driven_track(track, robot) for track in tracks]
        responses.append(_fit_response(name, choose_steps(name, driven_tracks, dead_time)))
    sources = dict.fromkeys(source for track in tracks for source in track.sources)
    problems = [(response.name, response.problem) for response in responses if response.problem]
    refuse_contradicted(tuple(sources), problems)
    return responses


def _search(steps: UsedSteps, units: ResponseParameters) -> tuple[Floats, Floats]:
    """Find the most likely vector of parameters (8,), from the best starts of a grid.

    Returns:
        The vector, and approximately its standard deviations (8,).
    """

    def compute_ln_posteriors(vectors: Floats) -> Floats:
        """Compute the ln posterior (V,) of vectors (V, 8), with a normal prior around 0.

        It is UNLIKELY where it would not be finite.
        """
        ln_posteriors = np.zeros(len(vectors))
        for i, vector in enumerate(vectors):
            parameters = units.scaled_by(vector)
            turn_likelihood = whiten_turns(steps, parameters).compute_restricted_ln_likelihood()
            distance_likelihood = whiten_distances(
                steps, parameters
            ).compute_restricted_ln_likelihood()
            ln_posteriors[i] = (
                turn_likelihood + distance_likelihood - np.square(vector).sum() / (2 * PRIOR_STD**2)
            )
        return np.where(np.isfinite(ln_posteriors), ln_posteriors, LOG_LIKELIHOOD_MIN)

    turning_lag_starts = np.log(GRID_TURNING_LAGS_S / LAG_UNIT_S)
    grid = list(product(GRID_DEAD_TIMES_S / DEAD_TIME_UNIT_S, turning_lag_starts))
    starts = np.zeros((len(grid), SEARCHED_COUNT))
    starts[:, :2] = grid
    best_start = starts[compute_ln_posteriors(starts).argmax()]
    optimum = minimize(
        lambda vector: -compute_ln_posteriors(vector[None])[0],
        best_start,
        method="BFGS",
        options={"gtol": GRADIENT_MAX},
    )
    return optimum.x, np.sqrt(np.diag(optimum.hess_inv))


def _fit_response(name: str, steps: UsedSteps) -> RobotResponse:
    """Fit one robot and return its values with their intervals."""
    command_integrals = integrate_over_tracks(steps.tracks, steps.dead_time, LAG_UNIT_S)[steps.rows]
    heading_noise = _noise(steps, steps.turned, command_integrals)
    position_noise = _noise(steps, steps.distance_along, command_integrals)
    units = ResponseParameters(  # of a vector of zeros
        dead_time=steps.dead_time,
        turning_lag=LAG_UNIT_S,
        speed_lag=LAG_UNIT_S,
        heading_walk=HEADING_WALK_UNIT,
        way_walk=DISTANCE_WALK_UNIT * steps.speed,
        heading_noise=max(HEADING_NOISE_UNIT, heading_noise),
        position_noise=max(POSITION_NOISE_UNIT_S * steps.speed, position_noise),
        clock_drift=steps.drift_unit,
    )
    vector, curvature_std = _search(steps, units)
    likeliest = units.scaled_by(vector)
    turn_gains = whiten_turns(steps, likeliest).fit_gains()
    distance_gains = whiten_distances(steps, likeliest).fit_gains()
    likeliest_vector = np.concatenate([vector, turn_gains, distance_gains])
    std = _compute_deviations(steps, units, likeliest_vector, curvature_std)
    searched_std = ResponseParameters(*std[:SEARCHED_COUNT].tolist())  # in the units of the search
    veer_std, turning_std, speed_std = std[SEARCHED_COUNT : SEARCHED_COUNT + 3].tolist()
    if steps.in_one_ratio:
        veer_std = math.inf
        turning_std = math.hypot(turning_std, ONE_RATIO_GAIN_STD * turn_gains[1])
        speed_std = math.hypot(speed_std, ONE_RATIO_GAIN_STD * distance_gains[0])

    # how much of the motion the commands explain
    command_integrals = likeliest.integrals(steps)
    without_lags = replace(likeliest, turning_lag=LAG_MIN_S, speed_lag=LAG_MIN_S)
    unlagged_integrals = without_lags.integrals(steps)
    windows = assign_windows(steps.begin_s, steps.begin_s + steps.duration_s)
    turning_explained = explain_steps(
        steps.turned,
        command_integrals @ turn_gains,
        unlagged_integrals[:, 1],
        likeliest.heading_noise,
        windows,
    )
    distance_explained = explain_steps(
        steps.moved,
        command_integrals @ distance_gains,
        unlagged_integrals[:, 0],
        likeliest.position_noise,
        windows,
    )
    clock_drift = None
    if steps.drift_unit:
        clock_drift = _normal(likeliest.clock_drift, steps.drift_unit * searched_std.clock_drift)
    return RobotResponse(
        name=name,
        dead_time=_dead_time(likeliest.dead_time, DEAD_TIME_UNIT_S * searched_std.dead_time),
        turning_lag=_create_lag_interval(likeliest.turning_lag, searched_std.turning_lag),
        speed_lag=_create_lag_interval(likeliest.speed_lag, searched_std.speed_lag),
        turning_gain=_normal(turn_gains[1], math.hypot(turning_std, GAIN_RESOLUTION)),
        speed_gain=_normal(distance_gains[0], math.hypot(speed_std, GAIN_RESOLUTION)),
        veer=_normal(turn_gains[0], veer_std),
        heading_offset=fit_heading_offset(steps.driven(command_integrals), steps.in_one_ratio),
        heading_walk=_create_log_normal_interval(likeliest.heading_walk, searched_std.heading_walk),
        heading_noise=_create_log_normal_interval(
            likeliest.heading_noise, searched_std.heading_noise
        ),
        way_walk=_create_log_normal_interval(likeliest.way_walk, searched_std.way_walk),
        position_noise=_create_log_normal_interval(
            likeliest.position_noise, searched_std.position_noise
        ),
        clock_drift=clock_drift,
        turning_explained=turning_explained,
        distance_explained=distance_explained,
        duration_s=max(track.duration_s for track in steps.tracks),
        intervals=len(steps.rows),
        left_out=steps.left_out,
    )


def _noise(steps: UsedSteps, measured: Floats, command_integrals: Floats) -> float:
    """Estimate the noise of poses from the correlation of neighbouring steps.

    The input is turns or distances (M,), and the integrals (M, 2) of the commands that cause them.
    """
    residuals = measured - command_integrals @ fit_robust_gains(measured, command_integrals)
    limit = CLIP * STD_OF_MEDIAN * float(np.median(np.abs(residuals)))
    clipped = np.clip(residuals, -limit, limit)
    products = (clipped[1:] * clipped[:-1])[steps.neighbours]
    return math.sqrt(max(-float(products.mean()), 0.0)) if products.size else 0.0


def _compute_deviations(
    steps: UsedSteps, units: ResponseParameters, likeliest: Floats, curvature_std: Floats
) -> Floats:
    """Compute the standard deviations (12,) of the most likely parameters, followed by the gains.

    The gains are those of turns and distances. Each deviation is the larger of two: one from the
    curvature of the likelihood, and one from the jackknife over B blocks. Let s_b and H_b be the
    slope and curvature of the ln likelihood of block b, and H the curvature of all blocks. Without
    block b, the most likely vector changes by about -(H - H_b)^-1 s_b.
    """
    likeliest_parameters = units.scaled_by(likeliest[:SEARCHED_COUNT])
    step_sizes = np.ones(len(likeliest))
    step_sizes[:SEARCHED_COUNT] = np.clip(STEP_SIZE_STDS * curvature_std, STEP_SIZE_MIN, 1.0)
    regressions = (
        whiten_turns(steps, likeliest_parameters),
        whiten_distances(steps, likeliest_parameters),
    )
    gain_variances = [np.diag(np.linalg.inv(whitened.information)) for whitened in regressions]
    step_sizes[SEARCHED_COUNT:] = np.sqrt(np.concatenate(gain_variances))

    def compute_block_ln_likelihoods(changes: Floats) -> Floats:
        """Compute the ln likelihood of each block (B, V) after changes (1, V, 12) in units."""
        ln_likelihoods = []
        for values in likeliest + step_sizes * changes[0]:
            parameters = units.scaled_by(values[:SEARCHED_COUNT])
            turn_likelihoods = whiten_turns(steps, parameters).compute_ln_likelihoods(
                values[SEARCHED_COUNT : SEARCHED_COUNT + 2]
            )
            distance_likelihoods = whiten_distances(steps, parameters).compute_ln_likelihoods(
                values[SEARCHED_COUNT + 2 :]
            )
            ln_likelihoods.append(np.bincount(steps.block, turn_likelihoods + distance_likelihoods))
        return np.column_stack(ln_likelihoods)

    n_parameters = len(likeliest)
    slopes, curvatures = derivatives(compute_block_ln_likelihoods, n_parameters)
    curvature = curvatures.sum(axis=0)
    prior_weights = np.concatenate([whitened.prior[1] for whitened in regressions])
    curvature[range(SEARCHED_COUNT, n_parameters), range(SEARCHED_COUNT, n_parameters)] += (
        prior_weights * step_sizes[SEARCHED_COUNT:] ** 2
    )
    inverse = _invert_curvature(curvature)
    block_shifts = slopes @ inverse
    widening = compute_block_widening(np.diagonal(curvatures, axis1=1, axis2=2))
    jackknife_variance = len(block_shifts) * np.var(block_shifts, axis=0, ddof=1)
    variance = np.diag(inverse)
    return step_sizes * np.sqrt(np.maximum(variance, widening**2 * jackknife_variance))


def _invert_curvature(curvature: Floats) -> Floats:
    """Invert a curvature (K, K). Eigenvalues count by their magnitudes, at least the prior's."""
    eigenvalues, eigenvectors = np.linalg.eigh(curvature)
    return (eigenvectors / np.maximum(np.abs(eigenvalues), PRIOR_STD**-2)) @ eigenvectors.T


def _normal(value: float, std: float) -> SampleInterval:
    """Create the 95 % interval of a normally distributed value with this standard deviation."""
    half_width = Z_95 * std
    return SampleInterval(value, value - half_width, value + half_width)


def _dead_time(value: float, std: float) -> SampleInterval:
    """Create the interval of the dead time [s].

    Its ends are infinite if the data do not limit the dead time to within UNKNOWN_S.
    """
    if Z_95 * std > UNKNOWN_S:
        return SampleInterval(value, -math.inf, math.inf)
    return _normal(value, math.hypot(std, TIME_RESOLUTION_S))


def _create_lag_interval(value: float, std: float) -> SampleInterval:
    """Create the interval of a lag [s] whose logarithm has this standard deviation.

    It begins at 0 if the lag is near its minimum, at most twice LAG_MIN_S.
    """
    interval = _create_log_normal_interval(value, math.hypot(std, TIME_RESOLUTION_S / value))
    return replace(interval, low=0.0) if value <= 2 * LAG_MIN_S else interval


def _create_log_normal_interval(value: float, std: float) -> SampleInterval:
    """Create the interval of a value whose logarithm is normal with this standard deviation.

    It reaches from 0 to infinity if the logarithm is uncertain by more than UNKNOWN.
    """
    half_width = Z_95 * std
    if half_width > UNKNOWN:
        return SampleInterval(value, 0.0, math.inf)
    return SampleInterval(value, value * math.exp(-half_width), value * math.exp(half_width))

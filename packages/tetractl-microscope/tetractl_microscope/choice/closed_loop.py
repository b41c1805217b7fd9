"""Predicts how noise scatters the final positions of robots, with a linearised closed loop.

The deviation e (2N,) of the final positions from the plan, and the relative errors q (2N,) of
turning rate a and speed, are normal variables with a joint covariance: P of e, X of e with q, and
the variances of q (`Uncertainty`). For each signal, from first to last,

1. the controller measures the deviation, with noise propagated to the end, and corrects it by the
   remaining signals (`_update_for_correction`): for a deviation of covariance P, measured with
   noise M, the correction is the fraction C = R (R + P + M)^-1, which leaves

       P <- (1 - C) P (1 - C)' + C M C',     X <- (1 - C) X

   R is the covariance of the final positions if every remaining signal varies with the standard
   deviation SIGNAL_STD_RAD, and the stop comes a signal earlier or later;
2. the robots move (`_update_for_motion`): with the derivatives D (2N, 2N) of the ends with respect
to q
   during this signal alone, and W that of the heading's random walk, of variance w,

       P <- P + D Q D' + D X' + X D' + w W W',     X <- X + D Q,     Q = diag(variances of q)

3. a controller that identifies turning rate and speed plans with its estimates
   (`_update_for_identification`), which improve with every measurement: with the information I of
   this signal (`compute_information`),

       S = (1 + Q I)^-1,     Q <- Q S,     X <- X sqrt(S)

   This is an approximation: e is not changed by it, and keeps its correlation with q.

Without `corrects` there is no feedback.

The derivatives of the final positions: a step moves robot i by d(heading, u) and turns it by
w(heading, u). Let g_j be the derivative of the robot's final position with respect to its heading
before signal j, with g_L = 0. The chain rule backwards in time gives

    d end / d u_j = dd/du + g_{j+1} dw/du,      g_j = dd/dheading + g_{j+1} (1 + dw/dheading)

and likewise the derivatives with respect to the robot's turning rate a and speed.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ellipe

from tetractl.control.search.cost import predict
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats
from tetractl.core.registries import MOTIONS
from tetractl.model.motion.motion import in_rows
from tetractl.spec.plant import PlantSection
from tetractl.spec.section_abilities import Noisy


@dataclass(frozen=True, slots=True)
class LinearisedPlan:
    """A plan of L signals for N robots, linearised around its predicted path.

    It shows how small deviations change where the robots end. Lengths are in the spec's unit. The
    ends are the robots' final positions, in the order x_1,
    y_1, x_2, ...

    Attributes:
        target_distances: Distance of each robot's planned end from its target, shape (N,) [length
            unit].
        by_signal: Derivatives of the ends with respect to each signal [length unit/rad], shape
            (2N, L).
        by_heading: Derivatives of each end with respect to the robot's heading before each signal
            and at the end [length unit/rad], shape (L + 1, N, 2).
        by_a: Derivatives of each end with respect to ln a during one signal only [length unit],
            shape (L, N, 2).
        by_speed: Derivatives of each end with respect to ln speed during one signal only [length
            unit], shape (L, N, 2).
        turn_by_a: Derivative of the turn during each signal with respect to ln a [rad], shape (L,
            N).
        extra_step: Displacement of the ends by one more signal of straight motion [length unit],
            shape (2N, 1).
        durations_s: Duration of each signal [s], shape (L,).
    """

    target_distances: Floats
    by_signal: Floats
    by_heading: Floats
    by_a: Floats
    by_speed: Floats
    turn_by_a: Floats
    extra_step: Floats
    durations_s: Floats


def linearise_plan(problem: Problem, signals: Floats) -> LinearisedPlan:
    """Linearise a plan: compute how small deviations change the final positions of the robots.

    Args:
        problem: The robots' poses and parameters, and their targets.
        signals: Directions of the field, shape (L,) [rad].
    """
    n_robots = len(problem.a)
    n_signals = len(signals)
    path = predict(problem, signals)
    durations_s = np.full(n_signals, problem.period)
    durations_s[0] = problem.first_period
    step_derivatives = _compute_step_derivatives(problem, path[:-1, :, 2], signals, durations_s)
    step_by_heading, step_by_signal, step_by_a, step_by_speed = step_derivatives

    # g_j, backwards in time
    by_heading = np.zeros((n_signals + 1, n_robots, 2))
    for j in reversed(range(n_signals)):
        by_turn = by_heading[j + 1] * step_by_heading[j, :, 2:]
        by_heading[j] = step_by_heading[j, :, :2] + by_turn
    heading_after = by_heading[1:]

    def propagate_to_ends(step_derivative: Floats) -> Floats:
        """Convert derivatives of a step (L, N, 3) to derivatives of the ends (L, N, 2)."""
        return step_derivative[..., :2] + heading_after * step_derivative[..., 2:]

    ends = path[-1]
    end_directions = np.stack([np.cos(ends[:, 2]), np.sin(ends[:, 2])], axis=-1)
    extra_step = problem.period * problem.speed[:, None] * end_directions
    to_targets = ends[:, :2] - problem.targets
    by_signal = propagate_to_ends(step_by_signal).transpose(1, 2, 0)  # (N, 2, L)
    return LinearisedPlan(
        target_distances=np.hypot(to_targets[:, 0], to_targets[:, 1]),
        by_signal=by_signal.reshape(2 * n_robots, n_signals),
        by_heading=by_heading,
        by_a=propagate_to_ends(step_by_a),
        by_speed=propagate_to_ends(step_by_speed),
        turn_by_a=step_by_a[..., 2],
        extra_step=extra_step.reshape(2 * n_robots, 1),
        durations_s=durations_s,
    )


def _compute_step_derivatives(
    problem: Problem, headings: Floats, signals: Floats, durations_s: Floats
) -> Floats:
    """Compute how each robot's displacement and turn in a step depend on the step's conditions.

    The result has the shape (4, L, N, 3). It contains the derivatives of the displacement x, y and
    of the change of heading with respect to four variables: the heading before the step, the
    signal, ln a and ln speed.
    """
    lanes = MOTIONS.load(problem.motion).lanes
    robots = in_rows(problem)
    derivatives = np.empty((4, *headings.shape, 3))
    for j, signal in enumerate(signals):
        cos_u = np.cos(signal)
        sin_u = np.sin(signal)
        for i, heading in enumerate(headings[j]):
            cos_heading = np.cos(heading)
            sin_heading = np.sin(heading)
            _, by_heading, by_signal, by_parameters = lanes.differentiate(
                cos_heading, sin_heading, cos_u, sin_u, robots[i], durations_s[j]
            )
            derivatives[:, j, i] = (by_heading, by_signal, *by_parameters)
    return derivatives


SIGNAL_STD_RAD = float(np.pi / np.sqrt(3))
"""Standard deviation of a signal uniform in [-pi, pi] [rad]."""
VARIANCE_MIN = 1e-8
"""Minimum variance of a measured turn [rad^2] and of a relative path length.

An exact measurement would give infinite information.
"""
REGULARISATION = 1e-12
"""Value added to the diagonal of R + P + M, relative to the sum of their diagonals.

Without this value, the sum of these matrices would be singular for robots that stand still.
"""
REGULARISATION_MIN = 1e-30
"""Minimum value added to the diagonal of R + P + M [length unit^2]."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations of the noise of simulated robots and their camera.

    Attributes:
        a_std: Relative error of the turning rate a.
        speed_std: Relative error of the speed.
        heading_walk: Random walk of the heading [rad/sqrt(s)].
        position_std: Error of one measured coordinate [length unit].
        heading_std: Error of one measured heading [rad].
    """

    a_std: float = 0.0
    speed_std: float = 0.0
    heading_walk: float = 0.0
    position_std: float = 0.0
    heading_std: float = 0.0

    @classmethod
    def from_plant(cls, plant: PlantSection) -> "Noise":
        """Read the noise from the spec section of a simulated plant.

        An error that is uniform in [-e, e] has the standard deviation e / sqrt(3). For a lab, whose
        section contains no noise, all values are 0.
        """
        if not isinstance(plant, Noisy):
            return cls()
        measured = plant.measurement_noise
        return cls(
            a_std=plant.a_error / np.sqrt(3),
            speed_std=plant.speed_error / np.sqrt(3),
            heading_walk=plant.heading_noise,
            position_std=measured.position,
            heading_std=measured.heading,
        )


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """The joint covariance of the robots' final positions and the errors of their parameters.

    e is the deviation of the final positions from the plan. q are the relative errors of the
    turning rates a and the speeds.

    Attributes:
        end_covariance: Covariance of e, in the order x_1, y_1, x_2, ..., shape (2N, 2N) [length
            unit^2].
        cross_covariance: Covariance of e (rows) with q (columns), shape (2N, 2N) [length unit].
        parameter_variances: Variances of q: of ln a of each robot, then of ln speed, shape (2N,).
    """

    end_covariance: Floats
    cross_covariance: Floats
    parameter_variances: Floats


def predict_end_covariance(
    plan: LinearisedPlan, noise: Noise, corrects: bool = True, identifies: bool = False
) -> Floats:
    """Predict the covariance of the robots' final positions under a plan.

    Args:
        plan: The linearised plan.
        noise: The noise of the robots and the camera.
        corrects: Whether the controller corrects deviations during the plan.
        identifies: Whether the controller identifies turning rate a and speed.

    Returns:
        The covariance of x_1, y_1, x_2, ..., shape (2N, 2N) [length unit^2].
    """
    n_robots = len(plan.target_distances)
    zeros = np.zeros((2 * n_robots, 2 * n_robots))
    parameter_variances = np.repeat([noise.a_std**2, noise.speed_std**2], n_robots)
    uncertainty = Uncertainty(
        end_covariance=zeros, cross_covariance=zeros, parameter_variances=parameter_variances
    )
    for signal_index in range(len(plan.durations_s)):
        if corrects:
            uncertainty = _update_for_correction(uncertainty, plan, noise, signal_index)
        uncertainty = _update_for_motion(uncertainty, plan, noise, signal_index)
        if identifies:
            uncertainty = _update_for_identification(uncertainty, plan, noise, signal_index)
    return uncertainty.end_covariance


def _update_for_correction(
    uncertainty: Uncertainty, plan: LinearisedPlan, noise: Noise, signal: int
) -> Uncertainty:
    """Update the uncertainty for a correction by the remaining signals (step 1 of the module)."""
    ends_covariance = uncertainty.end_covariance
    eye = np.eye(len(ends_covariance))
    correction_effects = np.hstack([SIGNAL_STD_RAD * plan.by_signal[:, signal:], plan.extra_step])
    correctable_covariance = correction_effects @ correction_effects.T
    measurement_covariance = noise.position_std**2 * eye + noise.heading_std**2 * _block_diagonal(
        plan.by_heading[signal]
    )
    trace_sum = (
        np.trace(correctable_covariance)
        + np.trace(ends_covariance)
        + np.trace(measurement_covariance)
    )
    regularisation = max(REGULARISATION * trace_sum, REGULARISATION_MIN) * eye
    remaining_factor = (
        eye
        - np.linalg.solve(
            correctable_covariance + ends_covariance + measurement_covariance + regularisation,
            correctable_covariance,
        ).T
    )  # 1 - C
    corrected_factor = eye - remaining_factor
    return Uncertainty(
        end_covariance=remaining_factor @ ends_covariance @ remaining_factor.T
        + corrected_factor @ measurement_covariance @ corrected_factor.T,
        cross_covariance=remaining_factor @ uncertainty.cross_covariance,
        parameter_variances=uncertainty.parameter_variances,
    )


def _update_for_motion(
    uncertainty: Uncertainty, plan: LinearisedPlan, noise: Noise, signal: int
) -> Uncertainty:
    """Update the uncertainty for the robots' motion during one signal (step 2 of the module)."""
    derivatives = np.hstack(
        [_stack_in_columns(plan.by_a[signal]), _stack_in_columns(plan.by_speed[signal])]
    )
    variances = uncertainty.parameter_variances
    end_covariance_after = (
        uncertainty.end_covariance
        + derivatives @ (variances[:, None] * derivatives.T)
        + derivatives @ uncertainty.cross_covariance.T
        + uncertainty.cross_covariance @ derivatives.T
    )
    mid_derivatives = (plan.by_heading[signal] + plan.by_heading[signal + 1]) / 2
    walk_covariance = (
        noise.heading_walk**2 * plan.durations_s[signal] * _block_diagonal(mid_derivatives)
    )
    return Uncertainty(
        end_covariance_after + walk_covariance,
        uncertainty.cross_covariance + derivatives * variances,
        variances,
    )


def _update_for_identification(
    uncertainty: Uncertainty, plan: LinearisedPlan, noise: Noise, signal: int
) -> Uncertainty:
    """Update the uncertainty for the identification of a and speed (step 3 of the module)."""
    remaining_fraction = 1 / (
        1 + uncertainty.parameter_variances * compute_information(plan, noise, signal)
    )  # S
    return Uncertainty(
        uncertainty.end_covariance,
        uncertainty.cross_covariance * np.sqrt(remaining_fraction),
        uncertainty.parameter_variances * remaining_fraction,
    )


def compute_information(plan: LinearisedPlan, noise: Noise, signal: int) -> Floats:
    """Compute how much the measurements of one signal reveal about turning rates and speeds.

    The parameters are estimated from the headings and positions measured before and after the
    signal.

    Args:
        plan: The linearised plan.
        noise: The noise of the robots and the camera.
        signal: Index of the signal.

    Returns:
        The information: 1/variance of ln a of each robot, then of ln speed, shape (2N,).
    """
    turn_variance = (
        2 * noise.heading_std**2 + noise.heading_walk**2 * plan.durations_s[signal] + VARIANCE_MIN
    )
    a_information = plan.turn_by_a[signal] ** 2 / turn_variance
    path_squared = np.square(plan.by_speed[signal]).sum(
        axis=1
    )  # a path is proportional to the speed
    path_variance = np.maximum(2 * noise.position_std**2, VARIANCE_MIN * path_squared)
    speed_information = np.zeros_like(path_squared)
    np.divide(path_squared, path_variance, out=speed_information, where=path_variance > 0)
    return np.concatenate([a_information, speed_information])


def compute_mean_errors(covariance: Floats, target_distances: Floats) -> Floats:
    """Compute each robot's expected distance to its target at the end of a plan.

    The mean length m of a normal vector with standard deviations s1 >= s2 is sqrt(2/pi) s1 E(1 -
    s2^2/s1^2), with the complete elliptic integral E. With the distance d of the planned end from
    the target, the result is approximately sqrt(m^2 + d^2). It is exact if d or the deviation is 0.

    Args:
        covariance: Covariance of the ends x_1, y_1, x_2, ..., shape (2N, 2N) [length unit^2].
        target_distances: Distance of each planned end from its target, shape (N,) [length unit].

    Returns:
        The mean distances, shape (N,) [length unit].
    """
    variances = np.linalg.eigvalsh(extract_robot_covariances(covariance))  # (N, 2), ascending
    minor_variance, major_variance = np.maximum(variances, 0.0).T
    variance_ratio = np.ones_like(target_distances)
    np.divide(minor_variance, major_variance, out=variance_ratio, where=major_variance > 0)
    mean_deviation = np.sqrt(2 / np.pi * major_variance) * ellipe(1 - variance_ratio)
    return np.hypot(mean_deviation, target_distances)


def extract_robot_covariances(covariance: Floats) -> Floats:
    """Extract each robot's covariance (N, 2, 2) from the covariance (2N, 2N) of all robots."""
    n_robots = len(covariance) // 2
    robots = np.arange(n_robots)
    return covariance.reshape(n_robots, 2, n_robots, 2)[robots, :, robots, :]


def _stack_in_columns(vectors: Floats) -> Floats:
    """Arrange vectors (N, 2) in a matrix (2N, N): column i has vector i in rows 2i and 2i + 1."""
    n_vectors = len(vectors)
    robots = np.arange(n_vectors)
    columns = np.zeros((n_vectors, 2, n_vectors))
    columns[robots, :, robots] = vectors
    return columns.reshape(2 * n_vectors, n_vectors)


def _block_diagonal(vectors: Floats) -> Floats:
    """Return the block-diagonal matrix (2N, 2N) of v v' for each of N vectors v (2,)."""
    columns = _stack_in_columns(vectors)
    return columns @ columns.T

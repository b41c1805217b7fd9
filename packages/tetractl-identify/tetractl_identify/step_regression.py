"""The regression of a robot's turns and distances on its commands, for given parameters.

For given `ResponseParameters` (dead time, lags, random walks and noise), the steps are linear in
the gains. `Whitened` therefore computes their restricted likelihood in closed form. The gains have
a wide prior. It only matters if the data cannot separate two gains, as on circles. Two neighbouring
steps share the noise of the pose between them, with opposite signs, so the covariance of the steps
is tridiagonal.

Shapes: M steps. Pairs of integrals stand in columns: first of the speed, then of the turning rate.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky_banded, solve_banded

from tetractl.core.poses import Floats
from tetractl_identify.driven_steps import DEAD_TIME_UNIT_S, UsedSteps
from tetractl_identify.robot_response import LAG_MAX_S, LAG_MIN_S

LN_RATIO_MAX = 25.0
"""Maximum magnitude of the logarithm of a parameter in its unit: beyond it, numbers overflow."""
TURN_ERROR_RAD = 5e-4
"""Standard deviation by which the model errs in a turn [rad]."""
DISTANCE_ERROR_RATIO = 0.005
"""Standard deviation by which the model errs in a distance, relative to the usual one.

Robots do not drive exact arcs, and wheels turn by whole counts.
"""
GAIN_PRIOR_STD = 10.0
"""Standard deviation of the prior of the gains around 1, or relative to gains above 1.

It is so wide that the prior hardly matters.
"""
OTHER_PRIOR_STD = 1.0
"""Standard deviation of the prior of the other integral's contribution to a motion.

The prior is around 0, relative to the motion, and so wide that it hardly matters.
"""
ABSENT_GAIN_STD = 1e-6
"""Factor on OTHER_PRIOR_STD if the data cannot distinguish the two integrals."""


@dataclass(frozen=True, slots=True)
class ResponseParameters:
    """The parameters of a robot's response that a fit searches for.

    They are the dead time and lags [s], the random walks per sqrt(s), and the noises, each of the
    heading [rad] and of the distance or position [length unit]. A search uses them as a vector (8,)
    in the order of the fields. In it, the dead time is the difference from the expected one in
    DEAD_TIME_UNIT_S, and the drift of the clocks is in its own unit. All other entries are
    logarithms of the values divided by their units.
    """

    dead_time: float
    turning_lag: float
    speed_lag: float
    heading_walk: float
    way_walk: float
    heading_noise: float
    position_noise: float
    clock_drift: float

    def scaled_by(self, vector: Floats) -> "ResponseParameters":
        """Convert a vector (8,) to parameters.

        `self` contains the units. A vector of zeros gives the dead time of `self` and no drift.
        """
        factors = np.exp(np.clip(vector, -LN_RATIO_MAX, LN_RATIO_MAX))
        return ResponseParameters(
            dead_time=self.dead_time + DEAD_TIME_UNIT_S * vector[0],
            turning_lag=_clip_lag(self.turning_lag * factors[1]),
            speed_lag=_clip_lag(self.speed_lag * factors[2]),
            heading_walk=self.heading_walk * factors[3],
            way_walk=self.way_walk * factors[4],
            heading_noise=self.heading_noise * factors[5],
            position_noise=self.position_noise * factors[6],
            clock_drift=self.clock_drift * vector[7],
        )

    def integrals(self, steps: UsedSteps) -> Floats:
        """Integrate the lagging speed and turning rate over each step (M, 2)."""
        return steps.integrals(self.dead_time, self.speed_lag, self.turning_lag, self.clock_drift)


def _clip_lag(lag_s: float) -> float:
    """Limit a lag [s] to the range from LAG_MIN_S to LAG_MAX_S."""
    return min(max(lag_s, LAG_MIN_S), LAG_MAX_S)


@dataclass(frozen=True, slots=True)
class WhitenedSteps:
    """Turns or distances and their integrals, divided by the Cholesky root of their covariance.

    After this division, the noise of all steps is independent and has variance 1.

    Attributes:
        y: Whitened turns or distances, shape (M,). The residual y - x gains is white.
        x: Whitened integrals, shape (M, 2), of p and of q.
        ln_root_diagonal: Logarithms of the diagonal of the root, shape (M,).
        own_column: Column of the integral that the motion follows: 0 for distances, 1 for turns.
        is_own_only: Whether the other integral adds nothing.
    """

    y: Floats
    x: Floats
    ln_root_diagonal: Floats
    own_column: int
    is_own_only: bool

    @property
    def prior(self) -> tuple[Floats, Floats]:
        """The prior of the gains: its mean (2,), and the inverse of its variance (2,)."""
        lengths = np.linalg.norm(self.x, axis=0)
        scale = max(float(lengths[self.own_column]), float(np.linalg.norm(self.y)), 1e-12)
        std = OTHER_PRIOR_STD * (ABSENT_GAIN_STD if self.is_own_only else 1.0)
        weights = np.square(np.maximum(lengths, 1e-12) / (std * scale))
        weights[self.own_column] = np.square(
            max(float(lengths[self.own_column]), 1e-12) / (GAIN_PRIOR_STD * scale)
        )
        mean = np.zeros(2)
        mean[self.own_column] = 1.0
        return mean, weights

    @property
    def information(self) -> Floats:
        """The information matrix (2, 2) of the gains."""
        return np.asarray(self.x.T @ self.x + np.diag(self.prior[1]), dtype=np.float64)

    def fit_gains(self) -> Floats:
        """Compute the most likely gains (2,), of the integrals of p and of q."""
        mean, weights = self.prior
        gains = np.linalg.solve(self.information, self.x.T @ self.y + weights * mean)
        return np.asarray(gains, dtype=np.float64)

    def compute_ln_likelihoods(self, gains: Floats) -> Floats:
        """Compute the ln likelihood of each step (M,) for given gains (2,)."""
        return -self.ln_root_diagonal - np.square(self.y - self.x @ gains) / 2

    def compute_restricted_ln_likelihood(self) -> float:
        """Compute the restricted ln likelihood, in which the two gains are integrated out."""
        _, ln_information = np.linalg.slogdet(self.information)
        likelihoods = self.compute_ln_likelihoods(self.fit_gains())
        return float(likelihoods.sum() - ln_information / 2)


def _whiten_steps(
    measured: Floats,
    own_column: int,
    parameters: ResponseParameters,
    steps: UsedSteps,
    walk: float,
    noise: float,
    error: float,
) -> WhitenedSteps:
    """Whiten turns or distances (M,) and their integrals.

    The variance of a step is walk^2 times its duration, plus error^2, plus twice noise^2. The
    covariance of neighbours is -noise^2.
    """
    covariance = np.zeros((2, len(measured)))  # its diagonal, and the one below
    covariance[0] = walk**2 * steps.duration_s + error**2 + 2 * noise**2
    covariance[1, :-1] = np.where(steps.neighbours, -(noise**2), 0.0)
    cholesky_root = cholesky_banded(covariance, lower=True)
    whitened = solve_banded(
        (1, 0), cholesky_root, np.column_stack([measured, parameters.integrals(steps)])
    )
    y, x = whitened[:, 0], whitened[:, 1:]
    return WhitenedSteps(y, x, np.log(cholesky_root[0]), own_column, steps.in_one_ratio)


def whiten_turns(steps: UsedSteps, parameters: ResponseParameters) -> WhitenedSteps:
    """Whiten the turn of each step, so that its noise is independent and has variance 1.

    Args:
        steps: The steps of a robot.
        parameters: The parameters of its response, which determine the noise.
    """
    return _whiten_steps(
        steps.turned,
        1,
        parameters,
        steps,
        parameters.heading_walk,
        parameters.heading_noise,
        TURN_ERROR_RAD,
    )


def whiten_distances(steps: UsedSteps, parameters: ResponseParameters) -> WhitenedSteps:
    """Whiten the distance of each step along the heading; see `whiten_turns`."""
    error = DISTANCE_ERROR_RATIO * float(np.median(np.abs(steps.distance_along))) + 1e-12
    return _whiten_steps(
        steps.distance_along,
        0,
        parameters,
        steps,
        parameters.way_walk,
        parameters.position_noise,
        error,
    )

"""The prior: the assumptions about the robots' motion before they have moved."""

import math
from typing import NamedTuple

import numpy as np

from tetractl.core.elementary import hypot
from tetractl.core.motion_estimate import Estimate
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats


class Sticks(NamedTuple):
    """How often, and for how long, robots ignore commands.

    A wheeled robot may get stuck. A cell may rest, or back off and turn.
    """

    every_s: float = 30.0
    """Mean time until a robot gets stuck [s]."""
    for_s: float = 0.5
    """Mean time for which a robot stays stuck [s]."""
    strays: float = 0.0
    """Random walk of the position of a stuck robot [length unit/sqrt(s)]."""
    turns: float = 0.0
    """Random walk of the heading of a stuck robot [rad/sqrt(s)]."""


class Prior(NamedTuple):
    """The assumptions about N robots before they move: means and standard deviations.

    Attributes:
        a: Mean turning rates [rad/s], shape (N,).
        speed: Mean speeds [length unit/s], shape (N,).
        dead_time: Mean time from a command to its effect [s].
        a_std: Relative standard deviation of the turning rates.
        speed_std: Relative standard deviation of the speeds.
        dead_time_std: Standard deviation of the dead time [s]. With 0, the motion is certain.
        heading_bias_std: Standard deviation of the heading bias [rad]. The mean is 0.
        marker_bias_std: Standard deviation of the marker bias [rad]. The mean is 0.
        flow_std: Standard deviation of the flow [length unit/s]. The mean is 0.
        position_noise: Standard deviation of one measured position [length unit]. 0 if unknown.
        heading_noise: Standard deviation of one measured heading [rad]. 0 if unknown.
        helix_frequency: Usual frequency of a cell's helix [Hz].
        helix_radius: Usual radius of the helix [length unit]. 0 if there is no helix.
        lag: Time constant with which wheels follow commands [s]. 0 without wheels.
        lag_is_learnt: Whether the filters try other lags too.
        watchdog: Time without a command after which a robot stops [s].
        side_std: Standard deviation of the `side` (`tetractl.model.motion.turn_rate`). The mean is
            0.
        sticks: How often, and for how long, robots ignore commands.
        pose_std: What the camera's grid and noise add to the standard deviations of x, y [length
            unit] and heading [rad].
        coarse: Whether the camera is so coarse that poses may repeat while robots move.
    """

    a: Floats
    speed: Floats
    dead_time: float
    a_std: float
    speed_std: float
    dead_time_std: float
    heading_bias_std: float
    marker_bias_std: float = 0.0
    flow_std: float = 0.0
    position_noise: float = 0.0
    heading_noise: float = 0.0
    helix_frequency: float = 0.0
    helix_radius: float = 0.0
    lag: float = 0.0
    lag_is_learnt: bool = False
    watchdog: float = math.inf
    side_std: float = 0.0
    sticks: Sticks = Sticks()
    pose_std: tuple[float, float, float] = (0.0, 0.0, 0.0)
    coarse: bool = False

    @property
    def certain(self) -> bool:
        """Whether the motion is known exactly, so that nothing has to be identified.

        This is so if the dead time has no uncertainty.
        """
        return self.dead_time_std == 0

    @property
    def swims(self) -> bool:
        """Whether the robots are cells, which swim on a helix of known radius and frequency."""
        return self.helix_radius > 0 and self.helix_frequency > 0

    def estimate(self) -> Estimate:
        """Return the means of the prior as an estimate, with absolute standard deviations."""
        std = hypot(self.heading_bias_std, self.marker_bias_std)
        return Estimate(
            a=self.a,
            a_std=self.a_std * self.a,
            speed=self.speed,
            speed_std=self.speed_std * self.speed,
            heading_bias=np.zeros_like(self.a),
            heading_bias_std=np.full_like(self.a, std),
            dead_time=self.dead_time,
            dead_time_std=self.dead_time_std,
            lag=np.full_like(self.a, self.lag) if self.lag_is_learnt else None,
        )


def certain_prior(problem: Problem, dead_time: float) -> Prior:
    """Create a prior for robots whose motion is known exactly.

    Turning rates and speeds come from the problem, and all standard deviations are 0. `dead_time`
    is the time from a command to its effect [s].
    """
    return Prior(problem.a, problem.speed, dead_time, 0.0, 0.0, 0.0, 0.0)

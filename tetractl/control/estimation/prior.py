"""The assumptions about the robots' motion before they have moved."""

import math
from typing import NamedTuple

import numpy as np

from tetractl.core.elementary import hypot
from tetractl.core.motion_estimate import Estimate
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats


class Sticks(NamedTuple):
    """How robots ignore commands for a while.

    A robot gets stuck; a cell rests, or backs off and turns.
    """

    every_s: float = 30.0  # mean time until it begins
    for_s: float = 0.5  # mean time for which it lasts
    strays: float = 0.0  # random walk of the position meanwhile [length unit/sqrt(s)]
    turns: float = 0.0  # random walk of the heading meanwhile [rad/sqrt(s)]


class Prior(NamedTuple):
    """The prior on N robots: means and standard deviations.

    `a` (N,) [rad/s] and `speed` (N,) [length unit/s] have relative standard deviations, the dead
    time [s] an absolute one; the mean heading bias, marker bias [rad] and flow [length unit/s] are
    0. `position_noise` [length unit] and `heading_noise` [rad] are standard deviations of one
    measurement, 0 if unknown. The helix has a usual frequency [Hz] and radius [length unit]; the
    radius is 0 if there is no helix. Wheels follow commands with a time constant `lag` [s], 0 for
    robots without wheels. If `lag_is_learnt`, the filters try other lags too. A robot that receives
    nothing for `watchdog` [s] stops. Now and then a robot does not do what it is sent: it `sticks`.
    The mean `side` is 0 (`tetractl.model.motion.turn_rate`). `spread` are what camera's grid and
    noise add to the deviations of x, y [length unit] and heading [rad]; the poses of a `coarse`
    camera may repeat.
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
    spread: tuple[float, float, float] = (0.0, 0.0, 0.0)
    coarse: bool = False

    @property
    def certain(self) -> bool:
        """Whether nothing is to be identified."""
        return self.dead_time_std == 0

    @property
    def swims(self) -> bool:
        """Whether the robots are cells, which swim on a helix."""
        return self.helix_radius > 0 and self.helix_frequency > 0

    def estimate(self) -> Estimate:
        """Return the prior's means as an estimate, with absolute standard deviations."""
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
    """Return the prior of robots whose motion is known, with a dead time [s]."""
    return Prior(problem.a, problem.speed, dead_time, 0.0, 0.0, 0.0, 0.0)

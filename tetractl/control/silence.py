"""Whether robots keep clear if they receive nothing for a while, as their radio may fail.

A robot that receives nothing keeps its last direction. A plan could head for a wall at full speed
and turn off just before it: if the signal of that turn is lost, the robot hits the wall. So a plan
is asked what happens if any one of its signals is the last that robots receive.
"""

import math
from dataclasses import dataclass
from typing import Self

from tetractl.control.kernels.motion import FlatProblem, flatten
from tetractl.control.kernels.prediction import unheard
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats
from tetractl.model.obstacles import Obstacles

STEP_MAX_S = 0.15
"""Longest time step of the paths of robots that receive nothing [s]; chosen."""


@dataclass(frozen=True, slots=True)
class Silence:
    """A while of `steps` time steps of `step_s` [s] in which robots receive nothing, and are to
    keep out of the obstacles of a problem and, their centres, its separation from each other."""

    problem: FlatProblem
    step_s: float
    steps: int

    @classmethod
    def during(
        cls, seconds: float, problem: Problem, obstacles: Obstacles, separation: float
    ) -> Self:
        """Return a silence of some seconds of a problem's robots, which are to keep out of these
        obstacles and this separation [length unit]."""
        steps = max(1, math.ceil(seconds / STEP_MAX_S))
        keeping_clear = flatten(problem)._replace(
            rows=obstacles.rows, walls=obstacles.walls, separation=float(separation)
        )
        return cls(keeping_clear, seconds / steps, steps)

    def keeps_clear(self, path: Floats, signals: Floats) -> bool:
        """Return whether robots keep clear, whichever of the signals (L,) is the last that they
        receive; path (at least L, N, 3) are the poses before each signal.

        A robot that is nearer to something at the beginning is not to come nearer still.
        """
        return unheard(signals, self.problem, self.step_s, self.steps, path)

"""Where robots are after they have followed a direction for a while."""

import numpy as np

from tetractl.core.plan import Problem
from tetractl.core.poses import Floats, Poses
from tetractl.core.registries import MOTIONS


def driven(
    problem: Problem, start: Poses, direction: Floats, seconds: Floats | float
) -> tuple[Floats, Floats, Floats]:
    """Return x, y and heading (..., N) of robots that start at `start` and drive for `seconds`.

    `seconds` [s] is a number or an array (..., 1). Robots follow `direction` (N,) [rad], NaN for a
    robot that stands still.
    """
    stands = np.isnan(direction)
    moving = np.where(stands, 0.0, seconds)
    towards = np.where(stands, 0.0, direction)
    if problem.bias is not None:
        towards = towards + problem.bias
    step = MOTIONS.load(problem.motion).step
    x, y, heading = step(start.x, start.y, start.heading, towards, problem.a, problem.speed, moving)
    if problem.flow is not None:
        x, y = x + moving * problem.flow[:, 0], y + moving * problem.flow[:, 1]
    return x, y, heading

"""Choose a direction for turns on the spot, if stationary robots have no safe plan.

A robot that faces a wall, and is nearer to it than its turning circle v / a, cannot drive away from
it. However, robots on wheels can turn on the spot. All of them turn to one direction u, by equation
(3) with speed 0, and then plans are searched again. The first of FACINGS directions u to be tried
is the one with the most free space straight ahead (`find_freest_direction`). That is the direction
with the largest mean over t in (0, AHEAD_S] of

    the minimum clearance of any robot at x_i + v_i t (cos u, sin u)  to obstacles, walls and robots

Robots in a row along a wall therefore drive away from it or, if the fastest robot is in front,
along it. If a turn fails, robots turn to the direction that is FACING_STEP places
further, because other headings and another frame allow other plans.
"""

from typing import NamedTuple

import numpy as np

from tetractl.control.search.discs import Discs
from tetractl.core import elementwise
from tetractl.core.plan import Problem
from tetractl.core.poses import wrap

FACINGS = 24
"""Number of directions to which robots can turn, spread evenly around the circle."""
AHEAD_S = 1.6
"""Duration of the straight drive whose free space is compared [s]: 240 to 320 mm for an m3pi."""
MOMENTS = 8
"""Number of moments of that drive at which the clearance is computed."""
STEPS_PER_TURN = 4
"""Number of control steps of a turn, 2.2 s. A robot facing away from u hardly turns at first."""
FACING_STEP = 7
"""A failed turn is followed by a turn to the direction this many places further: 105 degrees."""
FAILED_TURNS_MAX = 12
"""Number of failed turns, one after the other, after which robots do not turn again."""


class Turning(NamedTuple):
    """The turn on the spot that stationary robots are making.

    Attributes:
        facing: The direction to which they turn [rad]. None if they do not turn.
        steps: Number of control steps in which they have turned, to this direction and to earlier
            ones.
    """

    facing: float | None = None
    steps: int = 0

    def after_step(self, facing: float | None) -> "Turning":
        """Return the turn after one more control step.

        Args:
            facing: Direction to which the robots turn in this step [rad]. None if they do not turn.
        """
        return NOT_TURNING if facing is None else Turning(facing, self.steps + 1)


NOT_TURNING = Turning()


def choose_facing(
    problem: Problem, discs: Discs, separation: float, turning: Turning
) -> float | None:
    """Choose the direction to which stationary robots turn in the next control step.

    A direction is kept for STEPS_PER_TURN steps. If each step chose its own direction, a robot with
    the opposite heading would alternate between left and right turns at that unstable point.

    Args:
        problem: The problem of the control step.
        discs: The bodies of the robots.
        separation: Minimum distance between two robots [length unit].
        turning: How the robots have turned so far.

    Returns:
        The direction [rad]. None if FAILED_TURNS_MAX turns have failed.
    """
    if turning.facing is None:
        return find_freest_direction(problem, discs, separation)
    turns, steps = divmod(turning.steps, STEPS_PER_TURN)
    if steps > 0:
        return turning.facing
    if turns == FAILED_TURNS_MAX:
        return None
    return float(wrap(np.array(turning.facing + FACING_STEP * 2 * np.pi / FACINGS)))


def find_freest_direction(problem: Problem, discs: Discs, separation: float) -> float:
    """Find the direction in which the robots have the most free space straight ahead [rad].

    Args:
        problem: The problem of the control step.
        discs: The bodies of the robots.
        separation: Minimum distance between two robots [length unit].
    """
    directions = np.linspace(-np.pi, np.pi, FACINGS, endpoint=False)
    times_s = AHEAD_S / MOMENTS * np.arange(1, MOMENTS + 1)
    distances = times_s[:, None, None] * problem.speed  # (M, 1, N)
    x = problem.poses.x + distances * elementwise.cos(directions)[:, None]  # (M, U, N)
    y = problem.poses.y + distances * elementwise.sin(directions)[:, None]
    clearances = discs.min_clearance(x, y, separation)
    return float(directions[np.argmax(clearances.mean(axis=0))])

"""Choose a direction for turns on the spot, if stationary robots have no safe plan.

A robot that faces a wall, and is nearer to it than its turning circle v / a, cannot drive away from
it. However, robots on wheels can turn on the spot. All of them turn to one direction u, by equation
(3) with speed 0, and then plans are searched again. The first of FACINGS directions u to be tried
is the one with the most free space straight ahead (`roomiest`). That is the direction with the
largest mean over t in (0, AHEAD_S] of

    the minimum clearance of any robot at x_i + v_i t (cos u, sin u)  to obstacles, walls and robots

Robots in a row along a wall therefore drive away from it or, if the fastest robot is in front,
along it. If a turn fails, robots turn to the direction that is EVERY places further, because other
headings and another frame allow other plans.
"""

from typing import NamedTuple

import numpy as np

from tetractl.control.search.discs import Discs
from tetractl.core import elementwise
from tetractl.core.plan import Problem
from tetractl.core.poses import wrap

FACINGS = 24  # number of directions to which robots may turn
AHEAD_S = 1.6  # time of the straight drive [s], 240 to 320 mm for an m3pi
MOMENTS = 8  # of that drive, at which the clearance is computed
STEPS = 4  # control steps of a turn, 2.2 s: one that starts opposite to u hardly turns at first
EVERY = 7  # a turn in vain is followed by one to the 7th next direction: 105 degrees on
TURNS_IN_VAIN = 12  # number of turns in vain, one after the other, after which none helps


class Turning(NamedTuple):
    """The turn on the spot that stationary robots are making.

    Attributes:
        facing: The direction to which they turn [rad]. None if they do not turn.
        steps: Number of control steps in which they have turned, to this direction and to earlier
            ones.
    """

    facing: float | None = None
    steps: int = 0

    def then(self, facing: float | None) -> "Turning":
        """Return the state after a step in which the robots turn to `facing` [rad].

        None means that they do not turn.
        """
        return NOT_TURNING if facing is None else Turning(facing, self.steps + 1)


NOT_TURNING = Turning()


def next_facing(problem: Problem, discs: Discs, apart: float, turning: Turning) -> float | None:
    """Choose the direction to which stationary robots turn in the next control step.

    A direction is kept for STEPS steps. If each step chose its own direction, a robot with the
    opposite heading would alternate between left and right turns at that unstable point.

    Args:
        problem: The problem of the control step.
        discs: The bodies of the robots.
        apart: Minimum distance between two robots [length unit].
        turning: How the robots have turned so far.

    Returns:
        The direction [rad]. None if TURNS_IN_VAIN turns have failed.
    """
    if turning.facing is None:
        return roomiest(problem, discs, apart)
    turns, steps = divmod(turning.steps, STEPS)
    if steps > 0:
        return turning.facing
    if turns == TURNS_IN_VAIN:
        return None
    return float(wrap(np.array(turning.facing + EVERY * 2 * np.pi / FACINGS)))


def roomiest(problem: Problem, discs: Discs, apart: float) -> float:
    """Find the direction in which the robots have the most free space straight ahead [rad].

    Args:
        problem: The problem of the control step.
        discs: The bodies of the robots.
        apart: Minimum distance between two robots [length unit].
    """
    directions = np.linspace(-np.pi, np.pi, FACINGS, endpoint=False)
    seconds = AHEAD_S / MOMENTS * np.arange(1, MOMENTS + 1)
    way = seconds[:, None, None] * problem.speed  # (M, 1, N)
    x = problem.poses.x + way * elementwise.cos(directions)[:, None]  # (M, U, N)
    y = problem.poses.y + way * elementwise.sin(directions)[:, None]
    clearances = discs.min_clearance(x, y, apart)
    return float(directions[np.argmax(clearances.mean(axis=0))])

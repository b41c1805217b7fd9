"""Turns on the spot out of a corner, for standing robots of which no plan found is safe.

A robot nearer to a wall than its turning circle, v / a, that faces the wall cannot drive away from
it. But robots on wheels can turn on the spot: all turn to one direction u by (3) at speed 0, and
then plans are searched again. Of FACINGS directions u the first is the one in which robots have
most room straight ahead: that for which the mean over t in (0, AHEAD_S] of

    the least clearance of any robot at x_i + v_i t (cos u, sin u)   to obstacles, walls and robots

is greatest (`roomiest`). Robots in a row along a wall so drive away from it or, if the fastest
is in front, also along it. After a turn in vain robots turn to the direction EVERY places on,
because other headings and another picture allow other plans.
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
    """The direction [rad] to which standing robots turn, None if they do not, and in how many
    control steps they have turned, to it and to others before."""

    facing: float | None = None
    steps: int = 0

    def then(self, facing: float | None) -> "Turning":
        """Return what it is after a step in which the robots turn to `facing` [rad]."""
        return NOT_TURNING if facing is None else Turning(facing, self.steps + 1)


NOT_TURNING = Turning()


def next_facing(problem: Problem, discs: Discs, apart: float, turning: Turning) -> float | None:
    """Return the direction [rad] to which standing robots turn in the next control step, None if
    TURNS_IN_VAIN turns were in vain; `apart` is the least distance of two robots.

    A direction is kept for STEPS steps: if each step chose its own, a robot that stands opposite to
    them would turn to the left and to the right of that unstable point in turn.
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
    """Return the direction [rad] in which all robots have most room straight ahead, with `apart` as
    the least distance of two robots."""
    directions = np.linspace(-np.pi, np.pi, FACINGS, endpoint=False)
    seconds = AHEAD_S / MOMENTS * np.arange(1, MOMENTS + 1)
    way = seconds[:, None, None] * problem.speed  # (M, 1, N)
    x = problem.poses.x + way * elementwise.cos(directions)[:, None]  # (M, U, N)
    y = problem.poses.y + way * elementwise.sin(directions)[:, None]
    clearances = discs.least_clearance(x, y, apart)
    return float(directions[np.argmax(clearances.mean(axis=0))])

"""The hold of one robot that cannot stand still: each step sends the direction of least cost to go.

A robot's distance r beyond the radius R of its hold, max(r - R, 0), is the cost per time. Seen from
the robot, everything that matters is where its target lies: p, with x ahead and y to the left, in
units of v / a. A direction held for T, at the angle u from the heading, moves the target to
q(u) = rotate(-turn(u)) (p - way(u)), with `way` and `turn` of (1)-(3), so that the cost to go obeys

    V(p) = min over u of  (1 - gamma) mean over T of max(|p| - R, 0)  +  gamma V(q(u)),

which depends on a T and R alone and is solved once, on a grid, by policy iteration (R. A. Howard,
Dynamic Programming and Markov Processes, 1960). The direction of least sum of the V of several
robots is a bad one, since each V presumes that the others do not matter: `holding` is for them.

A robot that never stops is on average v / a or more from its target, whatever the direction and
however its heading wanders: with the unit vector t of its heading and the way x from its target,
x . t grows by at least v - a |x| on average, and stays bounded. The spec's `hold.radius` is
therefore taken for TIGHT v / a if it is less.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tetractl.control.evaluate import compiled_branches
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats, Integers, wrap
from tetractl.model.motion import exact

SIDE = 65  # of the grid
BEYOND = 4.0  # the grid ends so far beyond R, in v / a; from there on the cost grows by 1
DIRECTIONS = np.linspace(-np.pi, np.pi, 48, endpoint=False)
PARTS = 4  # of T, over which r is averaged
MEMORY = 12.0  # 1 / (1 - gamma) in units of 1 / a: two circles
ROUNDS, SWEEPS, SETTLED = 40, 30, 1e-4  # of policy iteration
AHEAD = 4  # signals of a plan
TIGHT = 1.1
"""The least R, in v / a: a smaller one lets the last 5 % of the time be farther away."""


@lru_cache(maxsize=64)
def cost_to_go(turn: float, radius: float) -> "CostToGo":
    """Return V for a T = `turn` and a radius in units of v / a."""
    reach = radius + BEYOND
    x, y = np.meshgrid(*[np.linspace(-reach, reach, SIDE)] * 2, indexing="ij")
    zero, one = np.zeros(len(DIRECTIONS)), np.ones(len(DIRECTIONS))
    now = np.zeros((len(DIRECTIONS), SIDE, SIDE))
    dx = dy = heading = zero
    for part in range(1, PARTS + 1):
        moved = exact.step(zero, zero, zero, DIRECTIONS, one, one, turn * part / PARTS)
        dx, dy, heading = (each[:, None, None] for each in moved)
        now += np.maximum(np.hypot(x - dx, y - dy) - radius, 0.0) / PARTS
    c, s = np.cos(heading), np.sin(heading)
    corners, shares, far = _corners(c * (x - dx) + s * (y - dy), c * (y - dy) - s * (x - dx), reach)
    kept = float(np.exp(-turn / (MEMORY + radius)))
    now = (1 - kept) * now + far
    value = np.maximum(np.hypot(x, y) - radius, 0.0)
    for _ in range(ROUNDS):
        every = now + kept * (shares * value.ravel()[corners]).sum(axis=0)
        best, before = every.argmin(axis=0)[None], value
        value = np.take_along_axis(every, best, 0)[0]
        if np.abs(value - before).max() < SETTLED:
            break
        least = np.take_along_axis(now, best, 0)[0]
        at, share = (np.take_along_axis(of, best[None], 1)[:, 0] for of in (corners, shares))
        for _ in range(SWEEPS):
            value = least + kept * (share * value.ravel()[at]).sum(axis=0)
    return CostToGo(radius, kept, value)


def _corners(x: Floats, y: Floats, reach: float) -> tuple[Integers, Floats, Floats]:
    """Return the indices (4, ...) of the grid's points around points (...), the shares (4, ...) of
    their values, and how far each point is beyond the grid (...)."""
    far = np.maximum(np.hypot(x, y) - reach, 0.0)
    i, j = (np.clip((of / reach + 1) / 2 * (SIDE - 1), 0, SIDE - 1 - 1e-9) for of in (x, y))
    row, column = i.astype(np.int64), j.astype(np.int64)
    i, j = i - row, j - column
    first = row * SIDE + column
    corners = np.stack([first, first + 1, first + SIDE, first + SIDE + 1])
    return corners, np.stack([(1 - i) * (1 - j), (1 - i) * j, i * (1 - j), i * j]), far


@dataclass(frozen=True, slots=True)
class CostToGo:
    """V of one robot on the grid (SIDE, SIDE), in units of v / a, with R and gamma."""

    radius: float
    kept: float
    value: Floats

    def cost(self, path: Floats, target: Floats, unit: float) -> Floats:
        """Return the cost to go (B,) after paths (PARTS + 1, B, 3), whose v / a is `unit`."""
        gaps = (target - path[1:, :, :2]) / unit
        now = np.maximum(np.hypot(gaps[..., 0], gaps[..., 1]) - self.radius, 0.0).mean(axis=0)
        (x, y), c, s = gaps[-1].T, np.cos(path[-1, :, 2]), np.sin(path[-1, :, 2])
        corners, shares, far = _corners(c * x + s * y, c * y - s * x, self.radius + BEYOND)
        after = (shares * self.value.ravel()[corners]).sum(axis=0)
        return (1 - self.kept) * now + far + self.kept * after


def hold_signals(problem: Problem, spec_a: float, spec_speed: float, radius: float) -> Floats:
    """Return the signals (AHEAD,) of least cost to go that keep a robot within a radius. The table
    is that of the spec's robot; a step ahead, and in v / a where more is asked than it can, the
    robot is as the `problem` knows."""
    unit = spec_speed / spec_a
    table = cost_to_go(spec_a * problem.period, max(radius / unit, TIGHT))
    if table.radius == TIGHT:
        unit = float(problem.speed[0] / problem.a[0])
    poses, found = problem.poses.array(), np.empty(AHEAD)
    for k in range(AHEAD):
        towards = DIRECTIONS + float(poses[0, 2])
        start = np.tile(poses, (len(towards), 1, 1))
        path = compiled_branches(problem, start, towards, np.zeros(PARTS), problem.period / PARTS)
        best = int(np.argmin(table.cost(path[:, :, 0], problem.targets[0], unit)))
        found[k], poses = towards[best], path[-1, best]
    return wrap(found)

"""The cost J of many sequences of signals at once, the paper's (7), compiled for speed.

It gives the same numbers as `tetractl.control.search.cost.evaluate`. Each of P sequences, called a
particle, moves N simulated robots of its own. All particles are simulated together, signal by
signal, so that the loops over them are vector code.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from tetractl.control.search.kernels.motion import advance, robot_of
from tetractl.control.search.kernels.obstacles import Contacts, count_hits
from tetractl.core.poses import Floats
from tetractl.model.motion.polynomials import sincos
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import (
    ENTRY_FAST,
    INLINE_FAST,
    PART_FAST,
    VECTOR_SIZE,
    inlined,
)

_sincos = inlined(sincos)


class Rollouts(NamedTuple):
    """Working arrays to simulate P sequences of signals, each with N robots of its own."""

    x: Floats
    """x of each robot of each particle [length unit], shape (N, P)."""
    y: Floats
    """y of each robot of each particle [length unit], shape (N, P)."""
    cos: Floats
    """Cosines of the robots' headings, shape (N, P)."""
    sin: Floats
    """Sines of the robots' headings, shape (N, P)."""
    cos_u: Floats
    """Cosine of each particle's present signal, shape (P,)."""
    sin_u: Floats
    """Sine of each particle's present signal, shape (P,)."""
    own_cos: Floats
    """Cosine of the direction to which one robot turns, the signal plus its bias, shape (P,)."""
    own_sin: Floats
    """Sine of that direction, shape (P,)."""
    contacts: Contacts
    """Working arrays to count what the robots touch, for P paths."""


@lru_cache(maxsize=64)
def rollouts_of(thread: int, robots: int, particles: int) -> Rollouts:
    """Allocate the arrays of one thread for a number of robots and of particles.

    Args:
        thread: Id of the thread.
        robots: Number of robots.
        particles: Number of particles.
    """
    x, y, cos, sin, hits = _aligned((5, robots, particles))
    cos_u, sin_u, own_cos, own_sin, *of_contacts = _aligned((8, particles))
    contacts = Contacts(hits, *of_contacts)
    return Rollouts(x, y, cos, sin, cos_u, sin_u, own_cos, own_sin, contacts)


def _aligned(shape: tuple[int, ...]) -> Floats:
    """Allocate an array that begins at a cache line.

    A vector across two lines takes twice the time.
    """
    size = math.prod(shape)
    raw = np.empty(size + VECTOR_SIZE)
    first = -raw.ctypes.data // raw.itemsize % VECTOR_SIZE
    return raw[first : first + size].reshape(shape)


@compiled(**ENTRY_FAST)
def costs(problem, rollouts, signals, total):
    """Compute the cost J of many sequences of signals, called from Python.

    Kernels call `compute_costs`. If they called this function, it would be optimised twice.

    Args:
        problem: The problem, a `FlatProblem`.
        rollouts: The working arrays.
        signals: The sequences [rad], one per column, shape (L, P).
        total: Filled with J of each sequence, shape (P,).

    Returns:
        Whether all costs are finite.
    """
    return compute_costs(problem, rollouts, signals, total)


@compiled(**PART_FAST)
def compute_costs(problem, rollouts, signals, total):
    """Compute the cost J of many sequences of signals, as a part of a kernel.

    Arrays are taken out of the problem and the rollouts before the loops, because inside them each
    access to a field would take as long as a dozen steps.

    Args:
        problem: The problem, a `FlatProblem`.
        rollouts: The working arrays.
        signals: The sequences [rad], one per column, shape (L, P).
        total: Filled with J of each sequence, shape (P,).

    Returns:
        Whether all costs are finite.
    """
    robots = problem.robots
    first = problem.first
    rest = problem.rest
    x = rollouts.x
    y = rollouts.y
    cos = rollouts.cos
    sin = rollouts.sin
    hits = rollouts.contacts.hits
    cos_u = rollouts.cos_u
    sin_u = rollouts.sin_u
    to_cos = rollouts.own_cos if problem.drifts else cos_u
    to_sin = rollouts.own_sin if problem.drifts else sin_u
    x_before = rollouts.contacts.x_before
    y_before = rollouts.contacts.y_before
    for i in range(len(robots)):
        for n in range(total.size):
            x[i, n] = problem.poses[i, 0]
            y[i, n] = problem.poses[i, 1]
            cos[i, n] = problem.cos[i]
            sin[i, n] = problem.sin[i]
            hits[i, n] = 0.0
    for j in range(signals.shape[0]):
        lanes = first if j == 0 else rest
        seconds = problem.first_period if j == 0 else problem.period
        for n in range(total.size):
            sin_u[n], cos_u[n] = _sincos(signals[j, n])
        for i in range(len(robots)):
            if problem.swept:
                for n in range(total.size):
                    x_before[n] = x[i, n]
                    y_before[n] = y[i, n]
            robot = robot_of(robots, i)
            if problem.drifts:
                c = problem.bias_cos[i]
                s = problem.bias_sin[i]
                for n in range(total.size):
                    to_cos[n] = cos_u[n] * c - sin_u[n] * s
                    to_sin[n] = sin_u[n] * c + cos_u[n] * s
            advance(lanes, x, y, cos, sin, to_cos, to_sin, i, robot, seconds)
            if problem.drifts:
                dx = problem.flow[i, 0] * seconds
                dy = problem.flow[i, 1] * seconds
                for n in range(total.size):
                    x[i, n] = x[i, n] + dx
                    y[i, n] = y[i, n] + dy
            count_hits(problem, x, y, i, rollouts.contacts)
        if problem.separation > 0:
            count_meetings(x, y, problem.separation, hits)
    return _add_up(problem, rollouts, total)


@compiled(**PART_FAST)
def count_meetings(x, y, separation, hits):
    """Count how often each robot is too close to a robot with a lower index, for each particle.

    Args:
        x: x of the robots, shape (N, P).
        y: y of the robots, shape (N, P).
        separation: Minimum distance between two robots [length unit].
        hits: Changed in place, shape (N, P): for each robot k < i whose distance from robot i is
            at most the separation, 1 is added to hits[i, n].
    """
    least = separation * separation
    for i in range(x.shape[0]):
        for k in range(i):
            for n in range(x.shape[1]):
                dx = x[i, n] - x[k, n]
                dy = y[i, n] - y[k, n]
                hits[i, n] += 1.0 if dx * dx + dy * dy <= least else 0.0


@compiled(**INLINE_FAST)
def _add_up(problem, rollouts, total):
    """Compute the cost J of each particle from f and P by (7). Return whether all are finite."""
    x = rollouts.x
    y = rollouts.y
    hits = rollouts.contacts.hits
    weight = problem.obstacle_weight
    for n in range(total.size):
        total[n] = 0.0
    for i in range(len(problem.robots)):
        target_x = problem.targets[i, 0]
        target_y = problem.targets[i, 1]
        for n in range(total.size):
            dx = x[i, n] - target_x
            dy = y[i, n] - target_y
            total[n] += math.sqrt(dx * dx + dy * dy) + weight * hits[i, n]  # (8), (9)
    finite = True
    for n in range(total.size):
        finite &= math.isfinite(total[n])
    return finite

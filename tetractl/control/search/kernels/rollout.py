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
    biased_cos: Floats
    """Cosine of the direction to which one robot turns, the signal plus its bias, shape (P,)."""
    biased_sin: Floats
    """Sine of the direction to which one robot turns, the signal plus its bias, shape (P,)."""
    contacts: Contacts
    """Working arrays to count what the robots touch, for P paths."""


@lru_cache(maxsize=64)
def rollouts_of(thread: int, n_robots: int, n_particles: int) -> Rollouts:
    """Allocate the arrays of one thread for a number of robots and of particles.

    Args:
        thread: Id of the thread.
        n_robots: Number of robots.
        n_particles: Number of particles.
    """
    x, y, cos, sin, hits = _allocate_aligned((5, n_robots, n_particles))
    cos_u, sin_u, biased_cos, biased_sin, *contact_arrays = _allocate_aligned((8, n_particles))
    contacts = Contacts(hits, *contact_arrays)
    return Rollouts(x, y, cos, sin, cos_u, sin_u, biased_cos, biased_sin, contacts)


def _allocate_aligned(shape: tuple[int, ...]) -> Floats:
    """Allocate an array that begins at a cache line.

    A vector across two lines takes twice the time.
    """
    size = math.prod(shape)
    buffer = np.empty(size + VECTOR_SIZE)
    start = -buffer.ctypes.data // buffer.itemsize % VECTOR_SIZE
    return buffer[start : start + size].reshape(shape)


@compiled(**ENTRY_FAST)
def costs(problem, rollouts, signals, particle_costs):
    """Compute the cost J of many sequences of signals, called from Python.

    Kernels call `compute_costs`. If they called this function, it would be optimised twice.

    Args:
        problem: The problem, a `FlatProblem`.
        rollouts: The working arrays.
        signals: The sequences [rad], one per column, shape (L, P).
        particle_costs: Filled with J of each sequence, shape (P,).

    Returns:
        Whether all costs are finite.
    """
    return compute_costs(problem, rollouts, signals, particle_costs)


@compiled(**PART_FAST)
def compute_costs(problem, rollouts, signals, particle_costs):
    """Compute the cost J of many sequences of signals, as a part of a kernel.

    Arrays are taken out of the problem and the rollouts before the loops, because inside them each
    access to a field would take as long as a dozen steps.

    Args:
        problem: The problem, a `FlatProblem`.
        rollouts: The working arrays.
        signals: The sequences [rad], one per column, shape (L, P).
        particle_costs: Filled with J of each sequence, shape (P,).

    Returns:
        Whether all costs are finite.
    """
    robots = problem.robots
    first_lanes = problem.first_lanes
    later_lanes = problem.later_lanes
    x = rollouts.x
    y = rollouts.y
    cos = rollouts.cos
    sin = rollouts.sin
    hits = rollouts.contacts.hits
    cos_u = rollouts.cos_u
    sin_u = rollouts.sin_u
    direction_cos = rollouts.biased_cos if problem.drifts else cos_u
    direction_sin = rollouts.biased_sin if problem.drifts else sin_u
    x_before = rollouts.contacts.x_before
    y_before = rollouts.contacts.y_before
    for i in range(len(robots)):
        for n in range(particle_costs.size):
            x[i, n] = problem.poses[i, 0]
            y[i, n] = problem.poses[i, 1]
            cos[i, n] = problem.cos[i]
            sin[i, n] = problem.sin[i]
            hits[i, n] = 0.0
    for j in range(signals.shape[0]):
        lanes = first_lanes if j == 0 else later_lanes
        seconds = problem.first_period if j == 0 else problem.period
        for n in range(particle_costs.size):
            sin_u[n], cos_u[n] = _sincos(signals[j, n])
        for i in range(len(robots)):
            if problem.swept:
                for n in range(particle_costs.size):
                    x_before[n] = x[i, n]
                    y_before[n] = y[i, n]
            robot = robot_of(robots, i)
            if problem.drifts:
                bias_cos = problem.bias_cos[i]
                bias_sin = problem.bias_sin[i]
                for n in range(particle_costs.size):
                    direction_cos[n] = cos_u[n] * bias_cos - sin_u[n] * bias_sin
                    direction_sin[n] = sin_u[n] * bias_cos + cos_u[n] * bias_sin
            advance(lanes, x, y, cos, sin, direction_cos, direction_sin, i, robot, seconds)
            if problem.drifts:
                dx = problem.flow[i, 0] * seconds
                dy = problem.flow[i, 1] * seconds
                for n in range(particle_costs.size):
                    x[i, n] = x[i, n] + dx
                    y[i, n] = y[i, n] + dy
            count_hits(problem, x, y, i, rollouts.contacts)
        if problem.separation > 0:
            count_meetings(x, y, problem.separation, hits)
    return _sum_costs(problem, rollouts, particle_costs)


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
    separation_squared = separation * separation
    for i in range(x.shape[0]):
        for k in range(i):
            for n in range(x.shape[1]):
                dx = x[i, n] - x[k, n]
                dy = y[i, n] - y[k, n]
                hits[i, n] += 1.0 if dx * dx + dy * dy <= separation_squared else 0.0


@compiled(**INLINE_FAST)
def _sum_costs(problem, rollouts, particle_costs):
    """Compute the cost J of each particle from f and P by (7). Return whether all are finite."""
    x = rollouts.x
    y = rollouts.y
    hits = rollouts.contacts.hits
    weight = problem.obstacle_weight
    for n in range(particle_costs.size):
        particle_costs[n] = 0.0
    for i in range(len(problem.robots)):
        target_x = problem.targets[i, 0]
        target_y = problem.targets[i, 1]
        for n in range(particle_costs.size):
            dx = x[i, n] - target_x
            dy = y[i, n] - target_y
            particle_costs[n] += math.sqrt(dx * dx + dy * dy) + weight * hits[i, n]  # (8), (9)
    all_finite = True
    for n in range(particle_costs.size):
        all_finite &= math.isfinite(particle_costs[n])
    return all_finite

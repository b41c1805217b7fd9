"""The motion of swimming cells in time steps: the axes of their helices follow the paper's (1)-(3).

Lengths are in micrometres. `model.swimmers` draws cells and states the source of each number.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from tetractl.core.poses import Floats

STEP_S = 0.005  # largest time step
SINK_UM = 10.0  # guess: standard deviation of cells' wander in depth
SINK_S = 5.0  # guess: time constant of the wander in depth


def steps_until(times: Sequence[float]) -> int:
    """Return the number of time steps in which `swim` reaches M `times` [s]."""
    since, steps = 0.0, 0
    for until in times:
        steps += math.ceil((until - since) / STEP_S)
        since = until
    return steps


def swim(state: Any, cells: Any, times: Any, noise: Any) -> Floats:
    """Advance N cells by the midpoint rule, in equal steps of at most STEP_S from each of the
    `times` (M,) [s] to the next; return x, y, heading, phase (4, M, N) at these times. Plain loops,
    to be compiled; arguments are arrays or lists of the same shapes.

    `state` (5, N), which is advanced in place, is x, y [um] and heading [rad] of the helix's axis,
    the phase [rad] on the helix and the depth [um]. `cells` (13, N) are the turning rate a [rad/s],
    the dipole's angle from the axis [rad], speed [um/s], walk of the heading [rad/sqrt(s)], turning
    of the phase [rad/s], field x, y [reference field], flow x, y [um/s] and the coordinates [um] of
    the left, right, lower and upper wall. `noise` (steps_until(times), 2, N) is standard normal.
    """
    x, y, heading, phase, depth = state[0], state[1], state[2], state[3], state[4]
    rates, biases, speeds, walks, turns = cells[0], cells[1], cells[2], cells[3], cells[4]
    across, up, east, north = cells[5], cells[6], cells[7], cells[8]
    left, right, bottom, top = cells[9], cells[10], cells[11], cells[12]
    path = np.empty((4, len(times), len(x)))
    since, step = 0.0, 0
    for k in range(len(times)):
        parts = math.ceil((times[k] - since) / STEP_S)
        dt = (times[k] - since) / max(parts, 1)
        since, pull, root = times[k], dt / SINK_S, math.sqrt(dt)
        jolt = SINK_UM * math.sqrt(2 * pull)
        for _ in range(parts):
            swerves, jolts = noise[step][0], noise[step][1]
            step += 1
            for i in range(len(x)):
                at, a, bias = heading[i], rates[i], biases[i]
                sine = up[i] * math.cos(at + bias) - across[i] * math.sin(at + bias)
                half = at + a * sine * dt / 2
                x[i] += (speeds[i] * math.cos(half) + east[i]) * dt
                y[i] += (speeds[i] * math.sin(half) + north[i]) * dt
                sine = up[i] * math.cos(half + bias) - across[i] * math.sin(half + bias)
                at += a * sine * dt  # (3)
                at += walks[i] * root * swerves[i]
                phase[i] += turns[i] * dt
                depth[i] += jolt * jolts[i] - pull * depth[i]
                # A cell that meets a wall slides along it (Ohmura et al.): it swims along the wall,
                # and leaves the wall once its heading points away from it.
                if x[i] < left[i] or x[i] > right[i]:
                    outwards = 1.0 if x[i] > right[i] else -1.0
                    x[i] = right[i] if x[i] > right[i] else left[i]
                    if math.cos(at) * outwards > 0:
                        at = math.pi / 2 if math.sin(at) >= 0 else -math.pi / 2
                if y[i] < bottom[i] or y[i] > top[i]:
                    outwards = 1.0 if y[i] > top[i] else -1.0
                    y[i] = top[i] if y[i] > top[i] else bottom[i]
                    if math.sin(at) * outwards > 0:
                        at = 0.0 if math.cos(at) >= 0 else math.pi
                heading[i] = at
        for i in range(len(x)):
            path[0, k, i], path[1, k, i] = x[i], y[i]
            path[2, k, i], path[3, k, i] = heading[i], phase[i]
    return path

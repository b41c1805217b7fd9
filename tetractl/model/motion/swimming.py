"""The motion of swimming cells in time steps: the axes of their helices follow the paper's (1)-(3).

Plain loops, compiled for the simulation and run as they are by the emulated dish. Lengths are in
micrometres. `model.swimmers` draws cells and states the source of each number.
"""

import math
from collections.abc import Sequence
from typing import Any

from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats, Times

STEP_S = 0.005  # largest time step
SINK_UM = 10.0  # guess: standard deviation of cells' wander in depth
SINK_S = 5.0  # guess: time constant of the wander in depth

PHASE, DEPTH, A, BIAS, SPEED, WALK, TURN, HELIX, GOING, FIELD, FLOW, WALLS, ROWS = (
    *range(3, 12),
    *(12, 14, 16, 20),
)
"""Rows of the array (ROWS, N) of N cells: 0-2 are x, y and heading of the helix's axis; PHASE [rad]
and DEPTH the body's place on the helix and the axis's height from focus; A [rad/s] the turning rate
at the reference field; BIAS [rad] the dipole's angle from the axis; SPEED [um/s]; WALK
[rad/sqrt(s)] the random walk of the heading; TURN [rad/s] the turning of the phase; HELIX the
helix's radius; GOING 1, or 0 for a cell that rests, which only drifts. Two rows each are the FIELD
x, y, as a fraction of the reference field, and the medium's FLOW x, y [um/s]; four rows the
coordinates of the left, right, lower and upper of the WALLS, along which cells slide."""


def steps_in(seconds: float) -> int:
    """Return the number of time steps in which `step` advances cells by a time [s]."""
    return math.ceil(seconds / STEP_S)


def steps_until(since_ns: int, times: Sequence[int]) -> int:
    """Return the number of time steps from `since_ns` from each of the `times` [ns] to the next."""
    steps = 0
    for until in times:
        steps += steps_in((until - since_ns) / SECOND)
        since_ns = until
    return steps


def torque(dipole: float, across: float, up: float) -> tuple[float, float]:
    """Return the turning rate for a = 1 by equation (3), for a dipole's direction [rad] in the
    field (across, up), and its derivative by the direction."""
    cos, sin = math.cos(dipole), math.sin(dipole)
    return up * cos - across * sin, -(up * sin + across * cos)


def step(body: Any, seconds: float, noise: Any) -> None:
    """Advance N cells `body` (ROWS, N) by a time [s], by the midpoint rule in equal steps of at
    most STEP_S; `noise` (at least steps_in(seconds), 2, N) is standard normal. Arrays or lists."""
    x, y, heading, phase, depth = body[0], body[1], body[2], body[PHASE], body[DEPTH]
    left, right, bottom, top = body[WALLS], body[WALLS + 1], body[WALLS + 2], body[WALLS + 3]
    parts = steps_in(seconds)
    dt = seconds / max(parts, 1)
    pull, root = dt / SINK_S, math.sqrt(dt)
    jolt = SINK_UM * math.sqrt(2 * pull)
    for k in range(parts):
        swerves, jolts = noise[k][0], noise[k][1]
        for i in range(len(x)):
            at, bias, a = heading[i], body[BIAS][i], body[A][i] * body[GOING][i]
            across, up, speed = body[FIELD][i], body[FIELD + 1][i], body[SPEED][i] * body[GOING][i]
            sine, _ = torque(at + bias, across, up)
            half = at + a * sine * dt / 2
            x[i] += (speed * math.cos(half) + body[FLOW][i]) * dt
            y[i] += (speed * math.sin(half) + body[FLOW + 1][i]) * dt
            sine, _ = torque(half + bias, across, up)
            at += a * sine * dt  # (3)
            at += body[WALK][i] * body[GOING][i] * root * swerves[i]
            phase[i] += body[TURN][i] * body[GOING][i] * dt
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


def swim(
    body: Floats, now_ns: int, times: Times, noise: Floats, unit_um: float, path: Floats
) -> None:
    """Advance N cells, `body` (ROWS, N), from `now_ns` to the last of the `times` (M,) [ns]; write
    x, y and heading of the bodies, in units of `unit_um`, at these into `path` (M, 3, N).

    `noise` (S, 2, N) is standard normal, a row for each time step. A path does not depend on how
    it is divided into calls.
    """
    since = now_ns
    used = 0
    for k in range(len(times)):
        seconds = (times[k] - since) / SECOND
        step(body, seconds, noise[used:])
        used += steps_in(seconds)
        since = times[k]
        for i in range(body.shape[1]):
            across, heading = body[HELIX, i] * math.cos(body[PHASE, i]), body[2, i]
            path[k, 0, i] = (body[0, i] - across * math.sin(heading)) / unit_um
            path[k, 1, i] = (body[1, i] + across * math.cos(heading)) / unit_um
            path[k, 2, i] = heading

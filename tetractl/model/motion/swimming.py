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

# the rows of the array (ROWS, N) of N cells
X = 0
"""x of the helix's axis."""
Y = 1
"""y of the helix's axis."""
HEADING = 2
"""Direction of the helix's axis [rad]."""
PHASE = 3
"""Place of the body on the helix [rad]."""
DEPTH = 4
"""Height of the axis from focus."""
A = 5
"""Turning rate at the reference field [rad/s]."""
BIAS = 6
"""Angle of the dipole from the axis [rad]."""
SPEED = 7
"""Speed along the axis [um/s]."""
WALK = 8
"""Random walk of the heading [rad/sqrt(s)]."""
TURN = 9
"""Turning of the phase [rad/s]."""
HELIX = 10
"""Radius of the helix."""
GOING = 11
"""1, or 0 for a cell that rests, which only drifts."""
FIELD = 12
"""Two rows: x and y of the field, as a fraction of the reference field."""
FLOW = 14
"""Two rows: x and y of the medium's flow [um/s]."""
WALLS = 16
"""Four rows: coordinates of the left, right, lower and upper wall, along which cells slide."""
ROWS = 20  # of the array


def steps_in(seconds: float) -> int:
    """Return the number of time steps in which `step` advances cells by a time [s]."""
    return math.ceil(seconds / STEP_S)


def steps_until(since_ns: int, times_ns: Sequence[int]) -> int:
    """Return the number of time steps from `since_ns` to the first of the times, and from each to
    the next."""
    steps = 0
    begin_ns = since_ns
    for end_ns in times_ns:
        steps += steps_in((end_ns - begin_ns) / SECOND)
        begin_ns = end_ns
    return steps


def torque(dipole: float, across: float, up: float) -> tuple[float, float]:
    """Return the turning rate for a = 1 by equation (3), for a dipole's direction [rad] in the
    field (across, up), and its derivative by the direction."""
    cos = math.cos(dipole)
    sin = math.sin(dipole)
    return up * cos - across * sin, -(up * sin + across * cos)


def step(body: Any, seconds: float, noise: Any) -> None:
    """Advance N cells `body` (ROWS, N) by a time [s], by the midpoint rule in equal steps of at
    most STEP_S; `noise` (at least steps_in(seconds), 2, N) is standard normal. Arrays or lists."""
    x = body[X]
    y = body[Y]
    heading = body[HEADING]
    phase = body[PHASE]
    depth = body[DEPTH]
    wall_left = body[WALLS]
    wall_right = body[WALLS + 1]
    wall_bottom = body[WALLS + 2]
    wall_top = body[WALLS + 3]
    parts = steps_in(seconds)
    dt = seconds / max(parts, 1)
    root = math.sqrt(dt)
    # the depth is an Ornstein-Uhlenbeck process: pulled to 0, and jolted
    pull = dt / SINK_S
    jolt = SINK_UM * math.sqrt(2 * pull)
    for k in range(parts):
        swerves = noise[k][0]
        jolts = noise[k][1]
        for i in range(len(x)):
            going = body[GOING][i]
            bias = body[BIAS][i]
            a = body[A][i] * going
            speed = body[SPEED][i] * going
            field_x = body[FIELD][i]
            field_y = body[FIELD + 1][i]
            theta = heading[i]
            # the heading in the middle of the step, which gives the way and the turn of all of it
            sine, _ = torque(theta + bias, field_x, field_y)
            half = theta + a * sine * dt / 2
            x[i] += (speed * math.cos(half) + body[FLOW][i]) * dt  # (1)
            y[i] += (speed * math.sin(half) + body[FLOW + 1][i]) * dt  # (2)
            sine, _ = torque(half + bias, field_x, field_y)
            theta += a * sine * dt  # (3)
            theta += body[WALK][i] * going * root * swerves[i]
            phase[i] += body[TURN][i] * going * dt
            depth[i] += jolt * jolts[i] - pull * depth[i]
            # A cell that meets a wall slides along it (Ohmura et al.): it swims along the wall,
            # and leaves the wall once its heading points away from it.
            if x[i] < wall_left[i] or x[i] > wall_right[i]:
                outwards = 1.0 if x[i] > wall_right[i] else -1.0
                x[i] = wall_right[i] if x[i] > wall_right[i] else wall_left[i]
                if math.cos(theta) * outwards > 0:
                    theta = math.pi / 2 if math.sin(theta) >= 0 else -math.pi / 2
            if y[i] < wall_bottom[i] or y[i] > wall_top[i]:
                outwards = 1.0 if y[i] > wall_top[i] else -1.0
                y[i] = wall_top[i] if y[i] > wall_top[i] else wall_bottom[i]
                if math.sin(theta) * outwards > 0:
                    theta = 0.0 if math.cos(theta) >= 0 else math.pi
            heading[i] = theta


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
            heading = body[HEADING, i]
            to_the_left = body[HELIX, i] * math.cos(body[PHASE, i])
            path[k, 0, i] = (body[X, i] - to_the_left * math.sin(heading)) / unit_um
            path[k, 1, i] = (body[Y, i] + to_the_left * math.cos(heading)) / unit_um
            path[k, 2, i] = heading

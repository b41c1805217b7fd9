"""The motion of swimming cells in time steps.

Cells swim on helices, whose axes follow the paper's equations (1)-(3). The code consists of plain
loops, which are compiled for the simulation, and run uncompiled by the emulated dish. Lengths are
in micrometres. `model.swimmers` samples cells and gives the source of each number.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from tetractl.core.clock import SECOND
from tetractl.core.elementary import cos, sin
from tetractl.core.poses import Floats, Times

STEP_S = 0.005  # largest time step
SINK_UM = 10.0  # guess: standard deviation of cells' wander in depth
SINK_S = 5.0  # guess: time constant of the wander in depth


class CellArrays(NamedTuple):
    """The state of N swimming cells, and the forces that act on them.

    Each array has shape (N,). `step` also takes lists of numbers instead of arrays.
    """

    x: Any
    """x of the helix's axis [um]."""
    y: Any
    """y of the helix's axis [um]."""
    heading: Any
    """Direction of the helix's axis [rad]."""
    phase: Any
    """Position of the body on the helix [rad]."""
    depth: Any
    """Height of the axis from focus [um]."""
    a: Any
    """Turning rate at the reference field [rad/s]. 0 for a cell without a magnet."""
    bias: Any
    """Angle of the dipole from the axis [rad]."""
    speed: Any
    """Speed along the axis [um/s]."""
    walk: Any
    """Random walk of the heading [rad/sqrt(s)]."""
    phase_rate: Any
    """Angular frequency of the helix, with which the phase grows [rad/s]."""
    helix_um: Any
    """Radius of the helix [um]."""
    going: Any
    """1 for a cell that swims, 0 for a resting cell, which only drifts with the flow."""
    field_x: Any
    """x of the field, as a fraction of the reference field."""
    field_y: Any
    """y of the field, as a fraction of the reference field."""
    flow_x: Any
    """x of the medium's flow [um/s]."""
    flow_y: Any
    """y of the medium's flow [um/s]."""
    wall_left: Any
    """x of the left wall, along which cells slide [um]. -inf if there is no wall."""
    wall_right: Any
    """x of the right wall [um]. inf if there is no wall."""
    wall_bottom: Any
    """y of the lower wall [um]. -inf if there is no wall."""
    wall_top: Any
    """y of the upper wall [um]. inf if there is no wall."""


def steps_in(seconds: float) -> int:
    """Return the number of time steps that `step` needs for a time [s]."""
    return math.ceil(seconds / STEP_S)


def steps_until(since_ns: int, times_ns: Sequence[int]) -> int:
    """Return how many time steps `swim` needs from `since_ns` to the last of some times.

    The times [ns] are in ascending order. Each interval between two of them has its own steps.
    """
    steps = 0
    begin_ns = since_ns
    for end_ns in times_ns:
        steps += steps_in((end_ns - begin_ns) / SECOND)
        begin_ns = end_ns
    return steps


def torque(dipole: float, across: float, up: float) -> tuple[float, float]:
    """Compute how fast a field turns a cell with a = 1, by equation (3), and the derivative.

    Args:
        dipole: Direction of the dipole [rad].
        across: x of the field, as a fraction of the reference field.
        up: y of the field, as a fraction of the reference field.
    """
    along = cos(dipole)
    aside = sin(dipole)
    return up * along - across * aside, -(up * aside + across * along)


def step(cells: CellArrays, seconds: float, noise: Any) -> None:
    """Advance N cells by the midpoint rule, in equal steps of at most STEP_S.

    Args:
        cells: The cells, changed in place.
        seconds: Duration [s].
        noise: Standard normal numbers, shape (at least steps_in(seconds), 2, N): swerves of the
            headings, and jolts of the depths.
    """
    x = cells.x
    y = cells.y
    heading = cells.heading
    phase = cells.phase
    depth = cells.depth
    wall_left = cells.wall_left
    wall_right = cells.wall_right
    wall_bottom = cells.wall_bottom
    wall_top = cells.wall_top
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
            going = cells.going[i]
            bias = cells.bias[i]
            a = cells.a[i] * going
            speed = cells.speed[i] * going
            field_x = cells.field_x[i]
            field_y = cells.field_y[i]
            theta = heading[i]
            # the heading in the middle of the step, which gives the way and the turn of all of it
            sine, _ = torque(theta + bias, field_x, field_y)
            half = theta + a * sine * dt / 2
            x[i] += (speed * cos(half) + cells.flow_x[i]) * dt  # (1)
            y[i] += (speed * sin(half) + cells.flow_y[i]) * dt  # (2)
            sine, _ = torque(half + bias, field_x, field_y)
            theta += a * sine * dt  # (3)
            theta += cells.walk[i] * going * root * swerves[i]
            phase[i] += cells.phase_rate[i] * going * dt
            depth[i] += jolt * jolts[i] - pull * depth[i]
            # A cell that meets a wall slides along it (Ohmura et al.): it swims along the wall,
            # and leaves the wall once its heading points away from it.
            if x[i] < wall_left[i] or x[i] > wall_right[i]:
                outwards = 1.0 if x[i] > wall_right[i] else -1.0
                x[i] = wall_right[i] if x[i] > wall_right[i] else wall_left[i]
                if cos(theta) * outwards > 0:
                    theta = math.pi / 2 if sin(theta) >= 0 else -math.pi / 2
            if y[i] < wall_bottom[i] or y[i] > wall_top[i]:
                outwards = 1.0 if y[i] > wall_top[i] else -1.0
                y[i] = wall_top[i] if y[i] > wall_top[i] else wall_bottom[i]
                if sin(theta) * outwards > 0:
                    theta = 0.0 if cos(theta) >= 0 else math.pi
            heading[i] = theta


def swim(
    cells: CellArrays, now_ns: int, times: Times, noise: Floats, unit_um: float, path: Floats
) -> None:
    """Advance N cells, and write their poses at given times.

    The path does not depend on how it is divided into calls.

    Args:
        cells: The cells, changed in place.
        now_ns: The time of the cells' state.
        times: Times of the poses [ns], shape (M,).
        noise: Standard normal numbers, one row for each time step, shape (S, 2, N).
        unit_um: The length unit of the path [um].
        path: Filled with x, y and heading of the bodies, shape (M, 3, N).
    """
    since = now_ns
    used = 0
    for k in range(len(times)):
        seconds = (times[k] - since) / SECOND
        step(cells, seconds, noise[used:])
        used += steps_in(seconds)
        since = times[k]
        for i in range(len(cells.x)):
            heading = cells.heading[i]
            to_the_left = cells.helix_um[i] * cos(cells.phase[i])
            path[k, 0, i] = (cells.x[i] - to_the_left * sin(heading)) / unit_um
            path[k, 1, i] = (cells.y[i] + to_the_left * cos(heading)) / unit_um
            path[k, 2, i] = heading

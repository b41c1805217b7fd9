"""Compiled functions that move simulated robots.

They are loops over the functions of `tetractl.model.motion`, and give the same bits:

    answer   computes what a host sends to robots on wheels, and how fast the wheels really turn
    roll     moves robots on wheels, `rolling.roll`
    swim     moves cells, `swimming.swim`

Import this module only where it is needed, because reading a spec needs no compiler.
"""

import math
from typing import NamedTuple

import numpy as np

from tetractl.core.poses import Floats
from tetractl.model.motion import rolling, swimming
from tetractl.model.motion.rolling import KnownRobots, SentRates
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY, exact, wrap_called_functions

roll = compiled(**ENTRY)(wrap_called_functions(rolling.roll, exact))
swim = compiled(**ENTRY)(wrap_called_functions(swimming.swim, exact))
_wish = exact(rolling.wish)
_note = exact(rolling.note)
_count = exact(rolling.count)


class Trains(NamedTuple):
    """The left and right wheels of N robots with their motors, shape (2, N) each."""

    owed: Floats
    """Rounding errors that are carried over to the next transmission [counts].

    `answer` changes them.
    """
    gain: Floats
    """Wheel speed for each count, as the host knows it [length unit/s]."""
    dead_zone: Floats
    """Largest count at which a wheel does not move, as the host knows it."""
    true_gain: Floats
    """True wheel speed for each count [length unit/s]."""
    true_dead_zone: Floats
    """True largest count at which a wheel does not move."""
    limit: Floats
    """Maximum count sent to each robot, shape (N,). 0 if speeds are not rounded to counts."""


@compiled(**ENTRY)
def answer(
    heading: Floats,
    u: Floats,
    since_ns: int,
    acts_ns: int,
    robots: KnownRobots,
    sent: SentRates,
    trains: Trains,
) -> tuple[Floats, Floats]:
    """Compute the wheel speeds that a host sends to robots, and the true speeds of the wheels.

    `rolling.wish` explains the arguments up to `sent`. The speeds are also recorded in `sent`.

    Args:
        heading: Measured headings [rad], shape (N,).
        u: Directions [rad], shape (N,).
        since_ns: Time of the measurement.
        acts_ns: When the command takes effect.
        robots: What the host knows of the robots.
        sent: The rates sent so far.
        trains: The wheels.

    Returns:
        The speeds as the host knows them, and the true ones, left and right (2, N) each [length
        unit/s].
    """
    wished = _wish(heading, u, since_ns, acts_ns, robots, sent)
    if robots.lag_s > 0:
        _note(sent, acts_ns, wished, robots.radius)
    true_speeds = np.empty(wished.shape)
    if trains.limit[0] == 0:  # speeds are not rounded to counts
        for side in range(2):
            for i in range(heading.size):
                true_speeds[side, i] = trains.true_gain[side, i] * wished[side, i]
        return wished, true_speeds
    steps = _count(wished, trains.owed, trains.gain, trains.dead_zone, trains.limit)
    for side in range(2):
        for i in range(heading.size):
            step = steps[side, i]  # counts beyond the dead zone
            true_step = 0.0
            if step != 0:
                counts = abs(step) + trains.dead_zone[side, i] - trains.true_dead_zone[side, i]
                true_step = math.copysign(max(counts, 0), step)
            wished[side, i] = trains.gain[side, i] * step
            true_speeds[side, i] = trains.true_gain[side, i] * true_step
    return wished, true_speeds

"""Compiled functions that move simulated robots.

The functions are loops over the functions of `tetractl.model.motion`, and give the same bits:

    compute_wheel_speeds  computes the speeds that a host sends to wheels, and the true speeds
    roll                  moves robots on wheels, see `rolling.roll`
    swim                  moves cells, see `swimming.swim`

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


class WheelArrays(NamedTuple):
    """The left and right wheels of N robots with their motors, as arrays of shape (2, N)."""

    rounding_errors: Floats
    """Rounding errors that are carried over to the next transmission [counts].

    `compute_wheel_speeds` changes them.
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
def compute_wheel_speeds(
    headings: Floats,
    directions: Floats,
    measured_ns: int,
    acts_ns: int,
    robots: KnownRobots,
    sent_rates: SentRates,
    wheels: WheelArrays,
) -> tuple[Floats, Floats]:
    """Compute the wheel speeds that a host sends to robots, and the true speeds of the wheels.

    See `rolling.wish` for the computation. The speeds are also recorded in `sent_rates`.

    Args:
        headings: Measured headings [rad], shape (N,).
        directions: Directions to which the robots turn [rad], shape (N,).
        measured_ns: Time of the measurement [ns].
        acts_ns: When the command takes effect [ns].
        robots: The robots as the host knows them.
        sent_rates: The rates sent so far.
        wheels: The wheels as the host knows them, and as they truly are.

    Returns:
        The speeds as the host knows them, and the true speeds [length unit/s]. Both have shape
        (2, N): left and right wheels.
    """
    known_speeds = _wish(headings, directions, measured_ns, acts_ns, robots, sent_rates)
    if robots.lag_s > 0:
        _note(sent_rates, acts_ns, known_speeds, robots.radius)
    true_speeds = np.empty(known_speeds.shape)
    if wheels.limit[0] == 0:  # speeds are not rounded to counts
        for side in range(2):
            for i in range(headings.size):
                true_speeds[side, i] = wheels.true_gain[side, i] * known_speeds[side, i]
        return known_speeds, true_speeds
    excess_counts = _count(
        known_speeds, wheels.rounding_errors, wheels.gain, wheels.dead_zone, wheels.limit
    )
    for side in range(2):
        for i in range(headings.size):
            excess = excess_counts[side, i]  # counts beyond the dead zone
            true_excess = 0.0
            if excess != 0:
                true_count = (
                    abs(excess) + wheels.dead_zone[side, i] - wheels.true_dead_zone[side, i]
                )
                true_excess = math.copysign(max(true_count, 0), excess)
            known_speeds[side, i] = wheels.gain[side, i] * excess
            true_speeds[side, i] = wheels.true_gain[side, i] * true_excess
    return known_speeds, true_speeds

"""Robots on wheels in a simulation: what is sent to them, and where they go.

The bits are those of the plain loops, `tetractl.model.motion.rolling`.
"""

import math

from tetractl.core.kernels.kernel_cache import compiled
from tetractl.core.kernels.kernel_options import ENTRY, exact, with_parts
from tetractl.core.poses import Floats, Times
from tetractl.model.motion import rolling

roll = compiled(**ENTRY)(with_parts(rolling.roll, exact))
_wish, _note, _count = exact(rolling.wish), exact(rolling.note), exact(rolling.count)


@compiled(**ENTRY)
def answer(
    heading: Floats,
    u: Floats,
    drives: bool,
    since_ns: int,
    acts_ns: int,
    known: Floats,
    lag_s: float,
    sent_ns: Times,
    sent: Floats,
    trains: Floats,
    speeds: Floats,
) -> None:
    """Write into `speeds` (2, 2, N) the wheel speeds sent, as the host knows them, and the true
    ones.

    The arguments are those of `rolling.wish`. `trains` (6, 2, N) are each wheel's rounding error
    owed [counts], gain and dead zone as known, gain and dead zone in truth, and largest count, 0 if
    speeds are not rounded.
    """
    wished = _wish(heading, u, drives, since_ns, acts_ns, known, lag_s, sent_ns, sent)
    if lag_s > 0:
        _note(acts_ns, wished, known, sent_ns, sent)
    owed, gain, zone, limit = trains[0], trains[1], trains[2], trains[5, 0]
    steps = _count(wished, owed, gain, zone, limit) if limit[0] > 0 else wished
    for side in range(2):
        for i in range(heading.size):
            known_speed = moved = steps[side, i]
            if limit[i] > 0:
                known_speed = gain[side, i] * moved
                counts = max(abs(moved) + zone[side, i] - trains[4, side, i], 0)
                moved = 0.0 if moved == 0 else math.copysign(counts, moved)
            speeds[0, side, i] = known_speed
            speeds[1, side, i] = trains[3, side, i] * moved

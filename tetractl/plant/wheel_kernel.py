"""Robots on wheels in B simulations: what is sent to them, and where they go.

The bits are those of the plain loops, `tetractl.model.motion.rolling`, for one trial or many.
"""

import math

from tetractl.core.kernels.kernel_cache import compiled
from tetractl.core.kernels.kernel_options import ENTRY, exact, with_parts
from tetractl.core.poses import Bools, Floats, Times
from tetractl.model.motion import rolling

roll = compiled(**ENTRY)(with_parts(rolling.roll, exact))
_wish, _note, _count = exact(rolling.wish), exact(rolling.note), exact(rolling.count)


@compiled(**ENTRY)
def answer(
    sends: Bools,
    heading: Floats,
    u: Floats,
    drives: Bools,
    since_ns: Times,
    acts_ns: Times,
    known: Floats,
    lag_s: float,
    sent_ns: Times,
    sent: Floats,
    trains: Floats,
    speeds: Floats,
) -> None:
    """Write into `speeds` (B, 2, 2, N) the wheel speeds sent, as the host knows them, and the true
    ones, for the trials that send, (B,).

    The arguments are those of `rolling.wish`, an axis more, but `known` and `lag_s` are the same in
    all trials. `trains` (B, 6, 2, N) are each wheel's rounding error owed [counts], gain and dead
    zone as known, gain and dead zone in truth, and largest count, 0 if speeds are not rounded.
    """
    for b in range(len(sends)):
        if not sends[b]:
            continue
        wished = _wish(
            heading[b], u[b], drives[b], since_ns[b], acts_ns[b], known, lag_s, sent_ns[b], sent[b]
        )
        if lag_s > 0:
            _note(acts_ns[b], wished, known, sent_ns[b], sent[b])
        owed, gain, zone, limit = trains[b, 0], trains[b, 1], trains[b, 2], trains[b, 5, 0]
        steps = _count(wished, owed, gain, zone, limit) if limit[0] > 0 else wished
        for side in range(2):
            for i in range(heading.shape[1]):
                known_speed = moved = steps[side, i]
                if limit[i] > 0:
                    known_speed = gain[side, i] * moved
                    counts = max(abs(moved) + zone[side, i] - trains[b, 4, side, i], 0)
                    moved = 0.0 if moved == 0 else math.copysign(counts, moved)
                speeds[b, 0, side, i], speeds[b, 1, side, i] = (
                    known_speed,
                    trains[b, 3, side, i] * moved,
                )

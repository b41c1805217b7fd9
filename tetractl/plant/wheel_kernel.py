"""Robots on wheels in a simulation: what is sent to them, and where they go.

The bits are those of the plain loops, `tetractl.model.motion.rolling`.
"""

import math

from tetractl.core.poses import Floats, Times
from tetractl.model.motion import rolling
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY, exact, with_parts

roll = compiled(**ENTRY)(with_parts(rolling.roll, exact))
_wish = exact(rolling.wish)
_note = exact(rolling.note)
_count = exact(rolling.count)

# the rows of the array (TRAIN_ROWS, 2, N) that describes the left and right wheels of N robots
OWED = 0
"""The rounding error that is carried to the next transmission [counts]."""
GAIN = 1
"""Wheel speed of one count, as the host knows it [length unit/s]."""
DEAD_ZONE = 2
"""Largest count at which a wheel does not move, as the host knows it."""
TRUE_GAIN = 3
"""The wheel's true gain [length unit/s]."""
TRUE_DEAD_ZONE = 4
"""The wheel's true dead zone [counts]."""
COUNT_LIMIT = 5
"""Largest count that is sent; 0 if speeds are not rounded to counts."""
TRAIN_ROWS = 6  # rows of the array of a drive train, above


@compiled(**ENTRY)
def answer(
    heading: Floats,
    u: Floats,
    drives: bool,
    since_ns: int,
    acts_ns: int,
    parameters: Floats,
    lag_s: float,
    sent_ns: Times,
    sent: Floats,
    trains: Floats,
    speeds: Floats,
) -> None:
    """Write into `speeds` (2, 2, N) the wheel speeds sent, as the host knows them, and the true
    ones, each left and right [length unit/s].

    The arguments up to `sent` are those of `rolling.wish`; what is sent is also noted there. The
    errors owed in `trains` (TRAIN_ROWS, 2, N) change.
    """
    wished = _wish(heading, u, drives, since_ns, acts_ns, parameters, lag_s, sent_ns, sent)
    if lag_s > 0:
        _note(acts_ns, wished, parameters, sent_ns, sent)
    gain = trains[GAIN]
    zone = trains[DEAD_ZONE]
    limit = trains[COUNT_LIMIT, 0]
    steps = _count(wished, trains[OWED], gain, zone, limit) if limit[0] > 0 else wished
    for side in range(2):
        for i in range(heading.size):
            step = steps[side, i]  # counts beyond the dead zone; without counts a speed
            known_speed = step
            true_step = step
            if limit[i] > 0:
                known_speed = gain[side, i] * step
                if step != 0:
                    counts = abs(step) + zone[side, i] - trains[TRUE_DEAD_ZONE, side, i]
                    true_step = math.copysign(max(counts, 0), step)
                else:
                    true_step = 0.0
            speeds[0, side, i] = known_speed
            speeds[1, side, i] = trains[TRUE_GAIN, side, i] * true_step

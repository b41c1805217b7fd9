"""The limits on memory and computing time for reading a log.

A few bytes of a file may need much memory or time: compressed zeros, empty messages, a spec with a
million particles. Each log therefore has a `Budget` of memory, from which the bytes needed are
subtracted before anything is unpacked or decoded. With these limits no command takes more than 30 s
and 1 GB on one log, and a log may contain about an hour of a trial at 120 Hz. The environment
variable that FACTOR names raises the limits, for a longer trial.
"""

import math
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

FACTOR = "TETRACTL_LOG_FACTOR"
"""Environment variable whose value multiplies the limits for a whole log."""

CHUNK_MAX = 1 << 24
"""Largest unpacked size of a chunk [bytes]; tetractl's chunks have about a million."""
RECORD_MAX = 1 << 22
"""Largest size of a message that is decoded, or of an attachment [bytes]; a step of 1000 robots has
about a million, and the largest spec too."""
PROBLEMS_MAX = 50
"""Largest number of damaged records of a log that are listed."""
OVERLAP = 8
"""Largest sum of the sizes of all records, which may overlap, as a multiple of the file's size."""

RECORD_COST = 1000
"""Bytes charged to the budget for a record outside a chunk, and for a schema or channel."""
MESSAGE_COST = 400
"""Bytes charged for each message before it is decoded, since even an empty message takes time."""
STEP_COST = 4000
SEARCH_COST = 1200
"""Bytes charged for a control step and for each of its searches, in addition to their numbers."""
NUMBER_COST = 16
"""Bytes charged for a decoded number."""


def factor() -> float:
    """Return the value of the environment variable that FACTOR names, at least 1."""
    with suppress(ValueError):
        given = float(os.environ.get(FACTOR, "1"))
        if math.isfinite(given):
            return max(1.0, given)
    return 1.0


def _scaled(base: float) -> Callable[[], int]:
    """Return a function for a limit of `base`, times `factor`."""
    return lambda: int(base * factor())


file_limit = _scaled(1 << 28)
"""Return the largest number of bytes to read of a file."""
seconds_limit = _scaled(15)
"""Return the largest processor time for computing the decisions of a log again [s]."""
swarm_limit = _scaled(2e8)
"""Return the largest size of one round of an optimiser; a round cannot be interrupted.

The size is the number of motions of a robot under one signal, times (1 + number of obstacles); each
takes a few nanoseconds and the memory of one coordinate.
"""
simulation_limit = _scaled(5e7)
"""Return the largest number of positions, times (1 + number of obstacles), for simulating a trial
again.
"""
path_limit = _scaled(5e8)
"""Return the largest number of pairs of a position with an obstacle or another robot for checking a
path; a pair takes 20 ns.
"""


class TooMuchError(ValueError):
    """A log would need more memory or computing time than the limits allow."""

    def __init__(self, what: str) -> None:
        super().__init__(f"{what}, more than tetractl reads; {FACTOR}=2 allows twice as much")


@dataclass(slots=True)
class Budget:
    """The memory that reading a log may still use [bytes]."""

    left: float = 0.0

    def __post_init__(self) -> None:
        self.left = 8e8 * factor()

    def spend(self, amount: float, what: str) -> None:
        """Subtract memory [bytes] used for `what`; TooMuchError if less is left."""
        self.left -= amount
        if self.left < 0:
            raise TooMuchError(f"it contains {what}")

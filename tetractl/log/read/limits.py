"""Bounds on the memory and the work of reading a log, all of them.

A few bytes of a file can expand enormously: compressed zeros, empty messages, a spec with a million
particles. Each log therefore has a `Budget`, which is charged in bytes of memory before anything is
unpacked or decoded. With these bounds no command takes more than 30 s and 1 GB on one log, and a
log may hold about an hour of a trial at 120 Hz. For a longer one the variable FACTOR raises all
bounds.
"""

import math
import os
from contextlib import suppress
from dataclasses import dataclass

FACTOR = "TETRACTL_LOG_FACTOR"
"""The variable of the environment by which the bounds on a whole log are multiplied."""

CHUNK = 1 << 24
"""Most bytes a chunk may unpack to; tetractl's have about a million."""
MESSAGE = 1 << 22
"""Most bytes of a message that is decoded: a step of 1000 robots has about a million."""
METADATA = 1 << 18
"""Most bytes of a metadata record: the result of 1000 robots has half as many."""
TIMING = 1 << 22
"""Most bytes of the record with the solve times: those of 400,000 steps."""
KEYS = 10_000
"""Most items of a metadata record."""
KEY = 200
"""Most characters of a key of a metadata record."""
ATTACHMENT = 1 << 22
"""Most bytes of an attachment; a spec may have a quarter of that."""
PROBLEMS = 50
"""Largest number of damaged records of a log that are listed."""
OVERLAP = 8
"""Bytes that overlapping records may read, as a multiple of the file's size."""

RECORD_COST = 1000
"""Bytes charged for a record outside a chunk, and for a schema or channel."""
MESSAGE_COST = 400
"""Bytes charged for a message before it is decoded; an empty one takes as long as others."""
STEP_COST = 4000
SEARCH_COST = 1200
"""Bytes charged for a control step and for each of its searches, without their numbers."""
NUMBER_COST = 16
"""Bytes charged for a decoded number."""


def factor() -> float:
    """Return the factor that the user set, at least 1."""
    with suppress(ValueError):
        given = float(os.environ.get(FACTOR, "1"))
        if math.isfinite(given):
            return max(1.0, given)
    return 1.0


def file_limit() -> int:
    """Return the most bytes that are read of a file."""
    return int((1 << 28) * factor())


def seconds_limit() -> float:
    """Return the most processor time that deciding the steps of a log again may take [s]."""
    return 15.0 * factor()


def swarm_limit() -> float:
    """Return the most that one round of an optimiser may take.

    Its unit is one robot moved by one signal past one obstacle, a few nanoseconds, in a round that
    nothing interrupts. As many coordinates are kept in memory.
    """
    return 2e8 * factor()


def simulation_limit() -> float:
    """Return the most positions times obstacles that a trial is simulated again with."""
    return 5e7 * factor()


def path_limit() -> float:
    """Return the most positions times obstacles that may be checked, some 20 ns each."""
    return 5e8 * factor()


class TooMuchError(ValueError):
    """A log would need more memory or work than its bounds allow."""

    def __init__(self, what: str) -> None:
        super().__init__(f"{what}, more than tetractl reads; {FACTOR}=2 allows twice as much")


@dataclass(slots=True)
class Budget:
    """The memory that a log may still take [bytes]."""

    left: float = 0.0

    def __post_init__(self) -> None:
        self.left = 8e8 * factor()

    def spend(self, amount: float, what: str) -> None:
        """Charge the memory of `what`; TooMuchError if it exceeds the rest."""
        self.left -= amount
        if self.left < 0:
            raise TooMuchError(f"it holds {what}")

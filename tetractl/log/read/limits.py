"""The three limits on reading a file, which anybody may have written.

They limit the bytes of the file, the bytes of a chunk, and the seconds. A log may contain more than
an hour of a trial at 120 Hz. For a longer trial, the environment variable that FACTOR names raises
the limits on a whole file.
"""

import math
import os
from contextlib import suppress
from pathlib import Path

from tetractl.core.errors import LogError

FACTOR = "TETRACTL_LOG_FACTOR"
"""Environment variable whose value multiplies the limits for a whole file."""

CHUNK_MAX = 1 << 24
"""Maximum unpacked size of a chunk, and maximum length of a row [bytes].

tetractl's chunks have about a million.
"""


def file_limit() -> int:
    """Return the largest size of a file, and of its chunks unpacked [bytes]."""
    return round(_factor() * (1 << 28))


def seconds_limit() -> float:
    """Return the maximum processor time for reading or recomputing a log [s].

    It applies to finding the records of a log, and to computing its decisions again.
    """
    return 15 * _factor()


def too_much(path: Path, what: str) -> LogError:
    """Return the error for a file that exceeds a limit by `what`."""
    return LogError(
        f"{path}: contains {what}, more than tetractl reads; {FACTOR}=2 allows twice as much"
    )


def _factor() -> float:
    with suppress(ValueError):
        factor = float(os.environ.get(FACTOR, "1"))
        if math.isfinite(factor):
            return max(1.0, factor)
    return 1.0

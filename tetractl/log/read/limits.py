"""Limits on reading a log file, which protect against damaged or malicious files.

There are three limits: the bytes of the file, the bytes of a chunk, and the processor time. A log
within these limits can contain more than an hour of a trial at 120 Hz. For a longer trial, the
environment variable that FACTOR_VARIABLE names raises the limits on a whole file.
"""

import math
import os
from contextlib import suppress
from pathlib import Path

from tetractl.core.errors import LogError

FACTOR_VARIABLE = "TETRACTL_LOG_FACTOR"
"""Environment variable whose value, 1 by default, multiplies the limits for a whole file."""

CHUNK_MAX = 1 << 24
"""Maximum size of an unpacked chunk, and maximum length of a row [bytes].

The chunks that tetractl writes have about a million bytes.
"""


def file_limit() -> int:
    """Return the maximum size of a file, and of all its chunks when unpacked [bytes]."""
    return round(_factor() * (1 << 28))


def seconds_limit() -> float:
    """Return the maximum processor time for reading or recomputing a log [s].

    It applies to finding the records of a log, and to computing its decisions again.
    """
    return 15 * _factor()


def limit_error(path: Path, excess: str) -> LogError:
    """Create the error for a file that exceeds a limit.

    Args:
        path: The file.
        excess: Describes what exceeds the limit, as part of the message, such as "9 bytes".
    """
    return LogError(
        f"{path}: the log contains {excess}, more than tetractl reads; "
        f"to double the limit, set the environment variable {FACTOR_VARIABLE}=2"
    )


def _factor() -> float:
    with suppress(ValueError):
        factor = float(os.environ.get(FACTOR_VARIABLE, "1"))
        if math.isfinite(factor):
            return max(1.0, factor)
    return 1.0

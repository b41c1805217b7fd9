"""The bytes of a log file, read once into memory.

The file is not mapped: somebody may shorten it meanwhile, and reading a mapped page that is gone
kills the process.
"""

import os
import stat
from pathlib import Path

from tetractl.core.errors import LogError
from tetractl.log.read.bounds import FACTOR, file_limit

_NO_WAIT, _BYTES = getattr(os, "O_NONBLOCK", 0), getattr(os, "O_BINARY", 0)  # not everywhere
_END = 4096  # zeros kept of those at the end: a record may end with some


def read_file(path: Path) -> tuple[bytes, int, str | None]:
    """Return the first bytes of a file, its size, and what is wrong where not all were read.

    Of zeros at the end, which a power cut leaves, few are returned. Raises LogError for what is no
    file, is empty, or cannot be read.
    """
    try:
        # A pipe without a writer would wait for ever, were it not for O_NONBLOCK.
        handle = os.open(
            path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        )
        with os.fdopen(handle, "rb") as file:
            found, limit = os.fstat(handle), file_limit()
            if not stat.S_ISREG(found.st_mode):
                raise LogError(f"{path}: is not a file")
            data = file.read(min(limit, found.st_size))
            size = found.st_size
    except IsADirectoryError:
        raise LogError(f"{path}: is a folder, not a log") from None
    except (OSError, ValueError) as error:
        raise LogError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    if not data:
        raise LogError(f"{path}: the file is empty")
    problem = None
    if size > len(data) == limit:
        problem = (
            f"only the first {limit} of its {size} bytes are read; {FACTOR}=2 reads twice that"
        )
    used = len(data.rstrip(b"\0")) + _END
    return data[:used] if used < len(data) else data, size, problem

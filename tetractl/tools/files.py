"""Writes files completely or not at all."""

from contextlib import suppress
from pathlib import Path

from tetractl.core.errors import LogError, UsageError


def save_whole(path: Path, data: bytes) -> None:
    """Write a file completely or not at all.

    Raises UsageError if its folder is missing, LogError if it cannot be written.
    """
    part = path.with_name(path.name + ".part")
    try:
        part.write_bytes(data)
        part.replace(path)
    except FileNotFoundError:
        raise UsageError(f"{path}: there is no folder {path.parent}") from None
    except OSError as error:
        with suppress(OSError):
            part.unlink()
        raise LogError(f"{path}: cannot be written: {error.strerror}") from error

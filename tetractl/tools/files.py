"""Create folders, write files completely or not at all, and lock files."""

from contextlib import suppress
from pathlib import Path

from tetractl.core.errors import LogError, UsageError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None


def make_folder(folder: Path) -> None:
    """Create a folder, with its parents, unless it exists.

    Raises:
        LogError: If that fails.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LogError(f"{folder}: the folder cannot be created: {error.strerror}") from error


def save_whole(path: Path, data: bytes) -> None:
    """Write a file completely or not at all, in place of an existing one.

    Raises:
        UsageError: If its folder is missing.
        LogError: If it cannot be written.
    """
    part = path.with_name(path.name + ".part")
    try:
        part.write_bytes(data)
        part.replace(path)
    except FileNotFoundError:
        raise UsageError(f"{path}: the folder {path.parent} does not exist") from None
    except OSError as error:
        with suppress(OSError):
            part.unlink()
        raise LogError(f"{path}: cannot be written: {error.strerror}") from error


def lock_file(descriptor: int) -> None:
    """Lock an open file until its process ends.

    On Windows, this does nothing, and two runs must not use the same folder.

    Raises:
        BlockingIOError: If another process has locked it.
    """
    if fcntl is not None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)

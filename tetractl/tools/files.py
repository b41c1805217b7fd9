"""Create folders, write files completely or not at all, and lock files."""

from contextlib import suppress
from pathlib import Path

from tetractl.core.errors import LogError, UsageError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None


def make_folder(folder: Path) -> None:
    """Create a folder and its parents, unless they exist.

    Raises:
        LogError: If the folder cannot be created.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LogError(f"{folder}: the folder cannot be created: {error.strerror}") from error


def write_atomically(path: Path, data: bytes) -> None:
    """Write a file completely or not at all. An existing file is replaced.

    Raises:
        UsageError: If the folder of the file is missing.
        LogError: If the file cannot be written.
    """
    part_path = path.with_name(path.name + ".part")
    try:
        part_path.write_bytes(data)
        part_path.replace(path)
    except FileNotFoundError:
        raise UsageError(f"{path}: the folder {path.parent} does not exist") from None
    except OSError as error:
        with suppress(OSError):
            part_path.unlink()
        raise LogError(f"{path}: cannot be written: {error.strerror}") from error


def lock_file(descriptor: int) -> None:
    """Lock an open file until this process ends.

    On Windows, this does nothing, and two runs must not use the same folder.

    Args:
        descriptor: Descriptor of the open file.

    Raises:
        BlockingIOError: If another process has locked the file.
    """
    if fcntl is not None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)

"""The lock of a batch's folder: one run at a time writes logs into it."""

import fcntl
import getpass
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from tetractl.core.errors import LogError, UsageError

LOCK_FILE = ".tetractl-lock"
OWNER_BYTES = 300


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder, a flock(2) on its file `.tetractl-lock`, which names the owner.

    The kernel releases the lock when the process that holds it ends, however it ends, so a file
    that is left behind on this host does not lock the folder. A file that a process of another
    host left does, because not every network file system passes locks on between hosts.

    Raises UsageError if another run holds the lock, LogError if the file cannot be written.
    """
    path = folder / LOCK_FILE
    try:
        file = _acquire(path)
    except OSError as error:
        raise LogError(f"{path}: cannot lock the folder: {error.strerror}") from error
    try:
        yield
    finally:
        with suppress(OSError):  # the folder may be gone
            path.unlink()
        os.close(file)


def _acquire(path: Path) -> int:
    """Return the descriptor of the locked file; raise UsageError if it is in use."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not _is(path, file):  # its last owner removed the file in between
                os.close(file)
                continue
            left = os.pread(file, OWNER_BYTES, 0).decode(errors="replace")
            if left and not left.startswith(f"{socket.gethostname()} "):
                raise _in_use(path, left, "; if that run has ended, remove the file " + LOCK_FILE)
            os.ftruncate(file, 0)
            os.pwrite(file, _owner().encode(errors="replace"), 0)
        except BlockingIOError:
            left = os.pread(file, OWNER_BYTES, 0).decode(errors="replace")
            os.close(file)
            raise _in_use(path, left) from None
        except BaseException:
            os.close(file)
            raise
        return file


def _is(path: Path, file: int) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(file))
    except FileNotFoundError:
        return False


def _owner() -> str:
    """Return "host pid user since", the four words of the lock's file."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a user id without a name
        user = str(os.getuid())
    return f"{socket.gethostname()} {os.getpid()} {user} {datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"


def _in_use(path: Path, owner: str, more: str = "") -> UsageError:
    words = owner.split()
    host, pid, user, since = words if len(words) == 4 else ("?",) * 4
    by = f"by process {pid} of {user} on {host} since {since}" if words else "by another run"
    by = "".join(c if c.isprintable() else "?" for c in by)
    return UsageError(
        f"{path.parent}: in use {by}", f"wait for that run, or name another folder with --out{more}"
    )

"""Lock a folder, so that two runs never write to the same one."""

import getpass
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from tetractl.core.errors import LogError, UsageError
from tetractl.tools.files import lock_file, make_folder

LOCK_FILE = ".tetractl-lock"
"""Name of the lock file in a folder to which only one run at a time may write."""
OWNER_BYTES = 300
"""Maximum size of a lock file that is read [bytes]: host, process and time need about 100."""
OPENED = os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NOFOLLOW", 0)
"""Flags with which the lock file is opened. No link is followed, if the system allows that."""


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Create a folder and hold its lock during the `with` block.

    The lock is a flock(2) on the file `.tetractl-lock`, which names the owner. The kernel releases
    the lock when the process that holds it ends, so a leftover file of this host does not lock the
    folder. A file of another host locks the folder, because not every network file system shares
    locks between hosts.

    Raises:
        UsageError: If another run holds the lock.
        LogError: If the folder or file cannot be written.
    """
    make_folder(folder)
    path = folder / LOCK_FILE
    try:
        file = _acquire(path)
    except OSError as error:
        raise LogError(f"{path}: the folder cannot be locked: {error.strerror}") from error
    try:
        yield
    finally:
        with suppress(OSError):  # the folder may have been removed
            path.unlink()
        os.close(file)


def _acquire(path: Path) -> int:
    """Open and lock a file, write the owner into it, and return its descriptor.

    Raises:
        UsageError: If another run has locked it, or it names an owner on another host.
    """
    while True:
        file = os.open(path, OPENED, 0o644)
        try:
            lock_file(file)
            if not _is(path, file):  # the last owner has removed the file in the meantime
                os.close(file)
                continue
            owner = os.pread(file, OWNER_BYTES, 0).decode(errors="replace")
            if owner and not owner.startswith(f"{socket.gethostname()} "):
                raise _in_use(path, owner, "; if that run has ended, remove the file " + LOCK_FILE)
            os.ftruncate(file, 0)
            os.pwrite(file, _owner().encode(errors="replace"), 0)
        except BlockingIOError:
            owner = os.pread(file, OWNER_BYTES, 0).decode(errors="replace")
            os.close(file)
            raise _in_use(path, owner) from None
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
    """Return the contents of a lock file: host, process id, user and time, in one line."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError, ImportError):  # the user id has no name, or users have no ids
        user = str(os.getuid()) if hasattr(os, "getuid") else "?"
    return f"{socket.gethostname()} {os.getpid()} {user} {datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"


def _in_use(path: Path, owner: str, more: str = "") -> UsageError:
    words = owner.split()
    host, pid, user, since = words if len(words) == 4 else ("?",) * 4
    by = f"by process {pid} of {user} on {host} since {since}" if words else "by another run"
    by = "".join(c if c.isprintable() else "?" for c in by)
    return UsageError(
        f"{path.parent}: in use {by}",
        f"wait for that run, or name another folder with --out{more}",
        f"wait for that run, or name another folder with folder={more}",
    )

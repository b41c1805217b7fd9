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
OWNER_BYTES_MAX = 300
"""Maximum size of a lock file that is read [bytes]: host, process and time need about 100."""
OPEN_FLAGS = os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NOFOLLOW", 0)
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
        descriptor = _acquire(path)
    except OSError as error:
        raise LogError(f"{path}: the folder cannot be locked: {error.strerror}") from error
    try:
        yield
    finally:
        with suppress(OSError):  # the folder may have been removed
            path.unlink()
        os.close(descriptor)


def _acquire(path: Path) -> int:
    """Open and lock the lock file, write this run into it, and return its descriptor.

    Raises:
        UsageError: If another run has locked the file, or the file names an owner on another host.
    """
    while True:
        descriptor = os.open(path, OPEN_FLAGS, 0o644)
        try:
            lock_file(descriptor)
            if not _is_same_file(
                path, descriptor
            ):  # the last owner has removed the file in the meantime
                os.close(descriptor)
                continue
            owner = os.pread(descriptor, OWNER_BYTES_MAX, 0).decode(errors="replace")
            if owner and not owner.startswith(f"{socket.gethostname()} "):
                raise _in_use_error(
                    path, owner, "; if that run has ended, remove the file " + LOCK_FILE
                )
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, _describe_owner().encode(errors="replace"), 0)
        except BlockingIOError:
            owner = os.pread(descriptor, OWNER_BYTES_MAX, 0).decode(errors="replace")
            os.close(descriptor)
            raise _in_use_error(path, owner) from None
        except BaseException:
            os.close(descriptor)
            raise
        return descriptor


def _is_same_file(path: Path, descriptor: int) -> bool:
    """Check whether a path leads to the file that is open under a descriptor."""
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except FileNotFoundError:
        return False


def _describe_owner() -> str:
    """Describe this run for a lock file: host, process id, user and time, in one line."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError, ImportError):  # the user id has no name, or users have no ids
        user = str(os.getuid()) if hasattr(os, "getuid") else "?"
    return f"{socket.gethostname()} {os.getpid()} {user} {datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"


def _in_use_error(path: Path, owner: str, extra_hint: str = "") -> UsageError:
    owner_fields = owner.split()
    host, pid, user, since = owner_fields if len(owner_fields) == 4 else ("?",) * 4
    owner_text = (
        f"by process {pid} of {user} on {host} since {since}" if owner_fields else "by another run"
    )
    owner_text = "".join(character if character.isprintable() else "?" for character in owner_text)
    return UsageError(
        f"{path.parent}: in use {owner_text}",
        f"wait for that run, or name another folder with --out{extra_hint}",
        f"wait for that run, or name another folder with folder={extra_hint}",
    )

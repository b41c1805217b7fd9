"""The cache folder for compiled code, which only its user can write to.

This module also computes the digests that name the files in the folder.

The files in the folder are executed: numba's files are pickles, and the firmware's cores are shared
libraries. A folder that another user can write to, or whose parents another user can replace, is
therefore never read.
"""

import atexit
import functools
import hashlib
import multiprocessing
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

FOLDER_VARIABLE = "TETRACTL_CACHE_DIR"
"""Environment variable that names the cache folder; worker processes inherit it."""

compile_listeners: list[Callable[[], None]] = []
"""Functions that are called before a kernel is compiled, because it is not in the cache."""

_OTHERS_WRITE_BITS = stat.S_IWGRP | stat.S_IWOTH  # bits of a mode by which other users can write


@functools.cache
def cache_folder() -> Path:
    """Return the user's cache folder for tetractl, mode 0700.

    If this folder cannot be made, or other users can write to it, a temporary folder is returned,
    which is removed at the end of the process. Raises OSError if no temporary folder can be made.
    """
    wanted_folder = _find_wanted_folder()
    problem = "the user has no home folder"
    if wanted_folder is not None:
        problem = claim_folder(wanted_folder)
        if problem is None:
            return wanted_folder
    temporary = Path(tempfile.mkdtemp(prefix="tetractl-"))  # 0700
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    os.environ[FOLDER_VARIABLE] = str(temporary)
    print_note_once(
        f"{problem}; compiled code is kept in a temporary folder, and removed after this run"
    )
    return temporary


def _find_wanted_folder() -> Path | None:
    stated_folder = os.environ.get(FOLDER_VARIABLE)
    if stated_folder:
        return Path(stated_folder).absolute()
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".cache").absolute() / "tetractl"
    except RuntimeError:  # there is neither $HOME nor an entry in the user database
        return None


def claim_folder(folder: Path) -> str | None:
    """Create a folder that only this user can write to, or take over an existing folder.

    If other users can read an existing folder, their permissions are removed.

    Returns:
        The reason why the folder cannot be used. None if it can be used.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        problem = describe_exposure(folder)
        if problem:
            return problem
        if folder.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO):
            folder.chmod(0o700)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        return f"{folder} cannot be used: {error.strerror or error}"
    return None


def describe_exposure(folder: Path) -> str | None:
    """Describe how other users can write to a folder. None if they cannot.

    The folder has to belong to the user, and each parent to the user or to root. A parent that
    others can write to must be sticky, like the temporary folder. A group of which the user is the
    only member counts as the user.
    """
    if not hasattr(os, "getuid"):  # Windows: files have no owners
        return None
    user_id = os.getuid()
    resolved_folder = folder.resolve(strict=True)
    for checked_folder in (resolved_folder, *resolved_folder.parents):
        status = checked_folder.stat()
        if status.st_uid not in ((user_id,) if checked_folder == resolved_folder else (user_id, 0)):
            return f"{checked_folder} belongs to another user"
        shared_bits = status.st_mode & _OTHERS_WRITE_BITS
        if shared_bits == stat.S_IWGRP and _is_only_member(status.st_gid):
            continue
        if shared_bits and (checked_folder == resolved_folder or not status.st_mode & stat.S_ISVTX):
            return f"others can write to {checked_folder}"
    return None


def read_checked_file(file: Path) -> bytes:
    """Read a file whose contents will be executed, after checking who can write to it.

    Raises:
        PermissionError: With the reason, if it belongs to another user, or others can write to it.
    """
    with file.open("rb") as opened:
        status = os.fstat(opened.fileno())
        if hasattr(os, "getuid") and status.st_uid not in (os.getuid(), 0):
            raise PermissionError(f"the file {file} belongs to another user")
        if hasattr(os, "getuid") and status.st_mode & stat.S_IWOTH:
            raise PermissionError(f"other users can write to the file {file}")
        return opened.read()


def _is_only_member(group: int) -> bool:
    """Check whether the user is the only member of a group.

    False if the user or group is unknown.
    """
    import grp
    import pwd

    try:
        name = pwd.getpwuid(os.getuid()).pw_name
        members = grp.getgrgid(group)
    except KeyError:
        return False
    return members.gr_name == name and set(members.gr_mem) <= {name}


def compiler_settings() -> str:
    """Format the environment variables that configure Numba, except NUMBA_CACHE_DIR, as text.

    The form is "NAME=value NAME=value ...", or "none" if none is set.
    """
    settings = (f"{key}={value}" for key, value in os.environ.items() if key.startswith("NUMBA_"))
    sorted_settings = sorted(
        setting for setting in settings if not setting.startswith("NUMBA_CACHE_DIR=")
    )
    return " ".join(sorted_settings) or "none"


@functools.cache
def print_note_once(note: str) -> None:
    """Print a note to stderr, unless this process has printed the same note before.

    The worker processes of a batch print nothing.
    """
    if multiprocessing.parent_process() is None:
        with suppress(OSError, ValueError):  # stderr may be closed
            print(f"note: {note}", file=sys.stderr)


@functools.cache
def file_digest(source: Path) -> bytes:
    """Return the SHA-256 of a file, which is read once in a process.

    Later changes are not noticed.
    """
    return hashlib.sha256(source.read_bytes()).digest()


def digest_files(sources: Iterable[Path], options: str = "") -> str:
    """Compute 12 hex digits of a hash of files and compiler options.

    Only the contents of the files count, wherever they are.
    """
    digests = sorted(map(file_digest, sources))
    combined_hash = hashlib.sha256(b"".join(digests))
    combined_hash.update(options.encode())
    return combined_hash.hexdigest()[:12]

"""Write an MCAP file to the disk: collect messages in chunks, and flush these regularly."""

import errno
import os
import shutil
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from pathlib import Path
from typing import BinaryIO, Concatenate, NoReturn, ParamSpec

from mcap.records import Attachment

from tetractl.core.errors import LogError
from tetractl.log.format.channels import DIGESTS, Entry, Record
from tetractl.log.write.mcap_records import NO_OTHERS, FileWriter, OtherChannels
from tetractl.tools.files import lock_file

CHUNK_S = 0.7
"""Maximum time for which a message stays in memory [s of wall time].

With camera frames collected over a control period of 0.2 s, a killed process loses less than 1.2 s
of its trial.
"""
SYNC_S = 1.0
"""Maximum time for which a power cut can lose written bytes [s of wall time]."""

TRIAL_PART = ".part"

P = ParamSpec("P")
Method = Callable[Concatenate["Sink", P], None]
_sync_data = os.fsync if sys.platform in ("darwin", "win32") else os.fdatasync


def _while_open(method: Method[P]) -> Method[P]:
    """Decorate a method that writes to the file of a log, so that it handles disk errors.

    On a closed sink, it does nothing. After an OSError, it closes the sink and raises LogError.
    """

    @wraps(method)
    def guarded(self: "Sink", *args: P.args, **kwargs: P.kwargs) -> None:
        if self._file is None:
            return
        try:
            method(self, *args, **kwargs)
        except OSError as error:
            self.fail(error)

    return guarded


class Sink:
    """The file of a log while it is written: NAME.part, renamed to NAME when it is complete.

    If a write fails, the call raises LogError and closes the file, which stays readable as
    NAME.part. Later calls do nothing, so that stopping a trial because of a full disk raises no
    second error.

    Args:
        path: The file when it is complete.
        part: The suffix while it is not. If it is not ".part", the file is a copy of a log: an
            unfinished earlier copy is replaced, unless a process is still writing it.
        others: Channels of the log that is copied.
    """

    def __init__(
        self, path: Path, part: str = TRIAL_PART, others: OtherChannels = NO_OTHERS
    ) -> None:
        self._path = path
        self._part = path.with_name(path.name + part)
        self._file: BinaryIO | None = None
        self._chunk_since: float | None = None  # when the open chunk's oldest message was added
        self._dirty_since: float | None = None  # when the oldest write that is not synced was made
        is_copy = part != TRIAL_PART
        must_be_new = (path,) if is_copy else (path, self._part)
        for name in must_be_new:  # never overwrite a log
            if os.path.lexists(name):
                raise LogError(
                    f"{name}: a log of this name exists already", "write the log to another folder"
                )
        try:
            self._file = _owned(self._part) if is_copy else self._part.open("x+b")
            _sync_folder(path.parent)
            self._mcap = FileWriter(self._file, others)
        except OSError as error:
            self.fail(error)

    @_while_open
    def add(self, record: Record) -> None:
        """Add a record. An attachment ends the chunk of the messages so far.

        A message may stay in memory until `flush_if_due` or the end of its chunk. Raises LogError
        if the disk fails. After that, and after `close`, nothing happens.
        """
        if isinstance(record, Attachment):
            self.flush()
        else:
            self._chunk_since = self._chunk_since or time.monotonic()
        self._mcap.add(record)

    def seal(self, unix_ns: int) -> None:
        """Add the digests of all records so far, by which readers detect changes."""
        digests = self._mcap.digests.hexdigests()
        self.add(Entry(DIGESTS, unix_ns, unix_ns, digests.SerializeToString()))

    @_while_open
    def flush(self) -> None:
        """End the present chunk of messages, and write it to the file."""
        self._mcap.flush()
        self._chunk_since = None
        self._dirty_since = self._dirty_since or time.monotonic()

    @_while_open
    def sync(self) -> None:
        """Wait until the disk has stored all records so far.

        Raises:
            LogError: If the disk fails, or the file was moved or removed.
        """
        self.flush()
        self._sync_written()

    def flush_if_due(self) -> float | None:
        """Flush messages older than CHUNK_S, and sync writes older than SYNC_S.

        Returns:
            The time until either is due again [s]. None if nothing waits.
        """
        due = []
        if self._chunk_since is not None:
            due.append(self._chunk_since + CHUNK_S)
        if self._dirty_since is not None:
            due.append(self._dirty_since + SYNC_S)
        if self._file is None or not due:
            return None
        now = time.monotonic()
        if min(due) > now:
            return min(due) - now
        if self._chunk_since is not None and self._chunk_since + CHUNK_S > now:
            # a simulation's chunks end by the trial's clock, so that they are the same in every run
            self._sync_written()
            return self._chunk_since + CHUNK_S - now
        self.sync()
        return None

    @_while_open
    def close(self, complete: bool) -> None:
        """Write the index and close the file.

        If `complete` is True, the file is renamed from NAME.part to NAME.
        """
        self._mcap.finish()
        self.sync()
        self._release()
        if complete:
            self._part.rename(self._path)
            _sync_folder(self._path.parent)

    def discard(self) -> None:
        """Close the file of an unwanted log, and remove it.

        This method never raises an OSError.
        """
        with suppress(OSError):
            self._release()
        with suppress(OSError):
            self._part.unlink()

    @_while_open
    def _sync_written(self) -> None:
        assert self._file is not None
        _sync_data(self._file.fileno())
        self._dirty_since = None
        self._check_exists()

    def _check_exists(self) -> None:
        """Check that the file is still in its place.

        Raises:
            OSError: If the file was moved or removed. A removed file is written again first.
        """
        assert self._file is not None
        mine = os.fstat(self._file.fileno())
        with suppress(FileNotFoundError, NotADirectoryError):
            if os.path.samestat(mine, self._part.stat()):
                return
        if mine.st_nlink == 0:  # the file was removed
            self._part.parent.mkdir(parents=True, exist_ok=True)
            self._file.seek(0)
            with self._part.open("xb") as copy:
                shutil.copyfileobj(self._file, copy)
            raise OSError(errno.ENOENT, "the file or its folder was removed during the trial")
        raise OSError(errno.ENOENT, "the file or its folder was moved during the trial")

    def fail(self, error: OSError) -> NoReturn:
        """Close the file as after a failed write, and raise LogError."""
        with suppress(OSError):  # closing writes the buffer, which fails again
            self._release()
        hint = None
        if os.path.lexists(self._part) and self._part.stat().st_size > 0:
            hint = f"the log written so far is in {self._part}"
        why = error.strerror or str(error)
        raise LogError(f"{self._path}: cannot write the log: {why}", hint) from error

    def _release(self) -> None:
        file = self._file
        self._file = None  # also if closing fails, as it does again on a full disk
        if file:
            file.close()


def _owned(path: Path) -> BinaryIO:
    """Create a file or empty it, and open it with a lock.

    The lock ends when the process ends, even if it is killed.

    Raises:
        OSError: If another process has locked it.
    """
    file = path.open("a+b")
    try:
        lock_file(file.fileno())
        file.truncate(0)
    except BlockingIOError:
        file.close()
        raise OSError(errno.EBUSY, "another process is already writing this log") from None
    return file


def _sync_folder(folder: Path) -> None:
    """Sync a folder, if the file system can, so that new names in it survive a power cut."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(handle)

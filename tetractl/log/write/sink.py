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
from tetractl.log.write.mcap_records import NO_OTHER_CHANNELS, FileWriter, OtherChannels
from tetractl.tools.files import lock_file

CHUNK_S = 0.7
"""Maximum time for which a message stays in memory [s of wall time].

With camera frames collected over a control period of 0.2 s, a killed process loses less than 1.2 s
of its trial.
"""
SYNC_S = 1.0
"""Maximum age of written bytes that a power cut can still lose [s of wall time]."""

TRIAL_PART_SUFFIX = ".part"
"""Suffix of the log of a trial that has not ended yet."""

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
        path: Path of the complete log.
        part_suffix: Suffix of the file while the log is incomplete. If the suffix is not ".part",
            the file is a copy of a log. Then an unfinished earlier copy is replaced, unless a
            process is still writing it.
        other_channels: Channels of the log that is copied.
    """

    def __init__(
        self,
        path: Path,
        part_suffix: str = TRIAL_PART_SUFFIX,
        other_channels: OtherChannels = NO_OTHER_CHANNELS,
    ) -> None:
        self._path = path
        self._part_path = path.with_name(path.name + part_suffix)
        self._file: BinaryIO | None = None
        self._chunk_since_s: float | None = None  # add time of the open chunk's oldest message
        self._unsynced_since_s: float | None = None  # time of the oldest write that is not synced
        is_copy = part_suffix != TRIAL_PART_SUFFIX
        must_be_new = (path,) if is_copy else (path, self._part_path)
        for file_path in must_be_new:  # never overwrite a log
            if os.path.lexists(file_path):
                raise LogError(
                    f"{file_path}: a log of this name exists already",
                    "write the log to another folder",
                )
        try:
            self._file = _open_locked(self._part_path) if is_copy else self._part_path.open("x+b")
            _sync_folder(path.parent)
            self._file_writer = FileWriter(self._file, other_channels)
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
            self._chunk_since_s = self._chunk_since_s or time.monotonic()
        self._file_writer.add(record)

    def seal(self, unix_ns: int) -> None:
        """Add the digests of all records so far, by which readers detect changes."""
        digests = self._file_writer.digests.hexdigests()
        self.add(Entry(DIGESTS, unix_ns, unix_ns, digests.SerializeToString()))

    @_while_open
    def flush(self) -> None:
        """End the present chunk of messages, and write it to the file."""
        self._file_writer.flush()
        self._chunk_since_s = None
        self._unsynced_since_s = self._unsynced_since_s or time.monotonic()

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
        due_times_s = []
        if self._chunk_since_s is not None:
            due_times_s.append(self._chunk_since_s + CHUNK_S)
        if self._unsynced_since_s is not None:
            due_times_s.append(self._unsynced_since_s + SYNC_S)
        if self._file is None or not due_times_s:
            return None
        now_s = time.monotonic()
        if min(due_times_s) > now_s:
            return min(due_times_s) - now_s
        if self._chunk_since_s is not None and self._chunk_since_s + CHUNK_S > now_s:
            # a simulation's chunks end by the trial's clock, so that they are the same in every run
            self._sync_written()
            return self._chunk_since_s + CHUNK_S - now_s
        self.sync()
        return None

    @_while_open
    def close(self, complete: bool) -> None:
        """Write the index and close the file.

        If `complete` is True, the file is renamed from NAME.part to NAME.
        """
        self._file_writer.finish()
        self.sync()
        self._release()
        if complete:
            self._part_path.rename(self._path)
            _sync_folder(self._path.parent)

    def discard(self) -> None:
        """Close the file of an unwanted log, and remove it.

        This method never raises an OSError.
        """
        with suppress(OSError):
            self._release()
        with suppress(OSError):
            self._part_path.unlink()

    @_while_open
    def _sync_written(self) -> None:
        assert self._file is not None
        _sync_data(self._file.fileno())
        self._unsynced_since_s = None
        self._check_exists()

    def _check_exists(self) -> None:
        """Check that the file is still in its place.

        Raises:
            OSError: If the file was moved or removed. A removed file is written again first.
        """
        assert self._file is not None
        open_file_stat = os.fstat(self._file.fileno())
        with suppress(FileNotFoundError, NotADirectoryError):
            if os.path.samestat(open_file_stat, self._part_path.stat()):
                return
        if open_file_stat.st_nlink == 0:  # the file was removed
            self._part_path.parent.mkdir(parents=True, exist_ok=True)
            self._file.seek(0)
            with self._part_path.open("xb") as copy:
                shutil.copyfileobj(self._file, copy)
            raise OSError(errno.ENOENT, "the file or its folder was removed during the trial")
        raise OSError(errno.ENOENT, "the file or its folder was moved during the trial")

    def fail(self, error: OSError) -> NoReturn:
        """Close the file as after a failed write, and raise LogError."""
        with suppress(OSError):  # closing writes the buffer, which fails again
            self._release()
        hint = None
        if os.path.lexists(self._part_path) and self._part_path.stat().st_size > 0:
            hint = f"the log written so far is in {self._part_path}"
        reason = error.strerror or str(error)
        raise LogError(f"{self._path}: cannot write the log: {reason}", hint) from error

    def _release(self) -> None:
        file = self._file
        self._file = None  # also if closing fails, as it does again on a full disk
        if file:
            file.close()


def _open_locked(path: Path) -> BinaryIO:
    """Open a file for writing under a lock. The file is created, or emptied if it exists.

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
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(descriptor)

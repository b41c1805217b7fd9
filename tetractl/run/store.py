"""The folder of a batch: its lock, its logs, and the missing trials of an interrupted batch."""

import fcntl
import getpass
import itertools
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from tetractl.core.errors import LogError, UsageError
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.load import spec_hash
from tetractl.log.read.find import LOG_PART, RECOVERED_SUFFIX, SUFFIX, attempt_name
from tetractl.log.read.reader import read_result
from tetractl.run.task import Finished, Task, log_path

LOCK_FILE = ".tetractl-lock"
OWNER_BYTES = 300


def make_folder(folder: Path) -> None:
    """Create the folder; LogError if that fails."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LogError(f"{folder}: cannot create the folder: {error.strerror}") from error


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Create a folder and hold its lock, a flock(2) on its file `.tetractl-lock`, which names the
    owner.

    The kernel releases the lock when the process that holds it ends, so a leftover file of this
    host does not lock the folder. A file of another host locks the folder, because not every
    network file system shares locks between hosts.

    Raises UsageError if another run holds the lock, LogError if folder or file cannot be written.
    """
    make_folder(folder)
    path = folder / LOCK_FILE
    try:
        file = _acquire(path)
    except OSError as error:
        raise LogError(f"{path}: cannot lock the folder: {error.strerror}") from error
    try:
        yield
    finally:
        with suppress(OSError):  # the folder may have been removed
            path.unlink()
        os.close(file)


def _acquire(path: Path) -> int:
    """Open and lock a file and return its descriptor; UsageError if another run has locked it."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not _is(path, file):  # the last owner has removed the file in the meantime
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
    except (KeyError, OSError):  # the user id has no name
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


def default_folder(name: str, now: datetime) -> Path:
    """Return logs/<spec name>-<UTC time>."""
    return Path("logs") / f"{name}-{now:%Y%m%dT%H%M%SZ}"


class TrialFolder:
    """The folder of a run: of a batch (`LogStore`) or of a study with its rows (`Store`)."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def arm_folder(self, arm: str) -> Path:
        """Return the folder for the logs of an arm; a batch has one arm, without a name."""
        return self.folder

    def place(self, arm: str, trial: int) -> Path:
        """Rename logs of earlier attempts of a trial, as `set_aside` does; return the folder for
        its log."""
        folder = self.arm_folder(arm)
        set_aside(folder, trial)
        return folder

    def add(self, task: Task, finished: Finished) -> None:
        """Store the record of a finished trial; in a batch, the log is the record."""


class LogStore(TrialFolder):
    """The folder of a batch; its logs are the only record of the trials that were run."""

    def __init__(self, folder: Path, experiment: Experiment) -> None:
        super().__init__(folder)
        self._experiment = experiment

    @contextmanager
    def opened(self, resume: bool) -> Iterator[list[int]]:
        """Create and lock the folder, and yield the numbers of the trials to run.

        Raises the errors of `lacking` and `locked`.
        """
        self.lacking(resume)  # checked first, so that a refused batch creates no folder
        with locked(self.folder):
            yield self.lacking(resume)

    def lacking(self, resume: bool) -> list[int]:
        """Return the numbers of the trials to run: all or, with `resume`, those that have no
        complete log.

        Raises UsageError for a folder with logs or, with `resume`, with logs of another spec or
        seed; only the number of trials may differ.
        """
        folder, count = self.folder, self._experiment.trials.count
        if folder.exists() and not folder.is_dir():
            raise UsageError(f"{folder}: not a folder", "name another with --out")
        names = (path.name for path in folder.iterdir()) if folder.exists() else ()
        if not resume and any(name.endswith((SUFFIX, LOG_PART)) for name in names):
            raise UsageError(
                f"{folder}: holds logs already", "name another folder with --out, or add --resume"
            )
        return [trial for trial in range(count) if not self._is_complete(trial)]

    def _is_complete(self, trial: int) -> bool:
        path = log_path(self.folder, trial)
        if not path.exists():
            return False
        try:
            found = read_result(path)
        except LogError:  # a log that cannot be read is renamed, and its trial is run again
            return False
        experiment = self._experiment
        same = experiment.model_copy(update={"trials": found.experiment.trials})
        if experiment.open:  # each trial chose its own robots
            own = {key: getattr(found.experiment, key) for key in ("robots", "chosen")}
            same = same.model_copy(update=own)
        if found.seed != experiment.trials.seed or spec_hash(found.experiment) != spec_hash(same):
            raise UsageError(
                f"{path}: was run with another spec or seed",
                "resume with the spec and seed of this log",
            )
        return found.outcome.complete and not found.recovered


def set_aside(folder: Path, trial: int) -> None:
    """Rename earlier logs of a trial that is to be run, to trial-003.attempt-1.mcap and so on.

    No earlier attempt is overwritten. A recovered log gets the attempt number of its source.
    """
    path = log_path(folder, trial)
    recovered = path.with_suffix(RECOVERED_SUFFIX)
    for left in (path, path.with_name(path.name + ".part")):
        if left.exists():
            number = next(i for i in itertools.count(1) if not _attempts(folder, left, i))
            for log in (left, recovered):
                if log.exists():
                    aside = log.with_name(attempt_name(log.name, number))
                    aside.touch(exist_ok=False)  # reserves the name
                    log.replace(aside)


def _attempts(folder: Path, log: Path, number: int) -> list[Path]:
    """Return the files of a trial's attempt `number`."""
    stem = log.name.partition(SUFFIX)[0]
    return [p for p in folder.iterdir() if p.name.startswith(f"{stem}.attempt-{number}.")]

"""The folder of a batch: its logs, and the trials that an interrupted batch lacks."""

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from tetractl.core.errors import LogError, UsageError
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.load import spec_hash
from tetractl.log.read.find import PART, RECOVERED_SUFFIX, SUFFIX, attempt_name
from tetractl.log.read.reader import read_result
from tetractl.run.batch import log_path
from tetractl.run.folder_lock import locked


def default_folder(name: str, now: datetime) -> Path:
    """Return logs/<spec name>-<UTC time>."""
    return Path("logs") / f"{name}-{now:%Y%m%dT%H%M%SZ}"


def trials_to_run(experiment: Experiment, folder: Path, resume: bool) -> list[int]:
    """Return the trials to run: all of them or, to resume, those without a complete log.

    Raises UsageError for a folder that holds logs already and, to resume, for logs of another spec
    or seed; only the number of trials may differ.
    """
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder}: not a folder", "name another with --out")
    count = experiment.trials.count
    if not resume and folder.exists() and any(map(_is_log, folder.iterdir())):
        raise UsageError(
            f"{folder}: holds logs already", "name another folder with --out, or add --resume"
        )
    return [trial for trial in range(count) if not _is_complete(experiment, folder, trial)]


@contextmanager
def batch_folder(experiment: Experiment, folder: Path, resume: bool) -> Iterator[list[int]]:
    """Create and lock the folder of a batch, set unfinished logs aside, yield the trials to run.

    Raises the errors of `trials_to_run`, `make_folder` and `locked`.
    """
    trials_to_run(experiment, folder, resume)  # nothing is made for a batch that is refused
    make_folder(folder)
    with locked(folder):
        todo = trials_to_run(experiment, folder, resume)
        for trial in todo:
            set_aside(folder, trial)
        yield todo


def make_folder(folder: Path) -> None:
    """Create the folder; LogError where the file system refuses."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LogError(f"{folder}: cannot create the folder: {error.strerror}") from error


def set_aside(folder: Path, trial: int) -> None:
    """Rename the logs of an unfinished trial to attempts, trial-003.attempt-1.mcap and so on.

    An attempt is never overwritten. A recovered log keeps the number of the log it comes from.
    """
    path = log_path(folder, trial)
    recovered = path.with_suffix(RECOVERED_SUFFIX)
    for left in (path, path.with_name(path.name + ".part")):
        if left.exists():
            number = next(i for i in itertools.count(1) if not _attempts(folder, left, i))
            for log in (left, recovered):
                if log.exists():
                    aside = log.with_name(attempt_name(log.name, number))
                    aside.touch(exist_ok=False)  # nobody else gets this name
                    log.replace(aside)


def _attempts(folder: Path, log: Path, number: int) -> list[Path]:
    """Return the logs of one trial that were set aside under a number."""
    stem = log.name.partition(SUFFIX)[0]
    return [p for p in folder.iterdir() if p.name.startswith(f"{stem}.attempt-{number}.")]


def _is_log(path: Path) -> bool:
    return path.name.endswith((SUFFIX, PART))


def _is_complete(experiment: Experiment, folder: Path, trial: int) -> bool:
    path = log_path(folder, trial)
    if not path.exists():
        return False
    try:
        found = read_result(path)
    except LogError:  # it is set aside and the trial is run again
        return False
    same = experiment.model_copy(update={"trials": found.experiment.trials})
    if found.seed != experiment.trials.seed or spec_hash(found.experiment) != spec_hash(same):
        raise UsageError(
            f"{path}: was run with another spec or seed", "resume with the spec it was run with"
        )
    return found.outcome.complete and not found.recovered

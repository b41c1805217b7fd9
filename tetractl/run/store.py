"""The folder of a run: its lock, the logs of its trials, and which trials are missing.

A batch is a folder with the logs of the trials of one experiment. A study is a folder of batches,
its arms.
"""

import itertools
import json
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

from tetractl.core.errors import LogError, UsageError
from tetractl.core.files import save_whole
from tetractl.core.plan import Outcome
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.load import arm_hash
from tetractl.log.read.find import LOG_PART, RECOVERED_SUFFIX, SUFFIX, attempt_name
from tetractl.log.read.reader import read_result
from tetractl.log.read.trial_log import ResultSummary
from tetractl.run.folder_lock import locked, make_folder
from tetractl.run.task import code_of, log_path


def default_folder(name: str, now: datetime) -> Path:
    """Return logs/<spec name>-<UTC time>."""
    return Path("logs") / f"{name}-{now:%Y%m%dT%H%M%SZ}"


class BatchFolder:
    """The folder of the trials of one experiment; `results` are those of its finished trials by
    number.

    A trial is finished if its log, whole or brief, is complete: if the trial was not interrupted
    and, unless this very code would abort it again, not aborted. All others are run, by
    `run --resume` as by a study.
    """

    def __init__(self, folder: Path, experiment: Experiment) -> None:
        self.folder, self.experiment = folder, experiment
        self.code, self.hash = code_of(experiment), arm_hash(experiment)
        self.results: dict[int, ResultSummary] = {}

    @property
    def lacking(self) -> list[int]:
        """The numbers of the trials that are not finished."""
        return [n for n in range(self.experiment.trials.count) if n not in self.results]

    @property
    def outdated(self) -> list[int]:
        """The numbers of the finished trials that another version of the code has run."""
        return [n for n, found in self.results.items() if found.code != self.code]

    def read(self) -> None:
        """Read which trials are finished; logs that are damaged or incomplete do not count.

        Raises UsageError if trials are of another spec or seed (only their number may differ).
        """
        self.results = {}
        for trial in range(self.experiment.trials.count):
            self.read_trial(trial)

    def read_trial(self, trial: int) -> None:
        """Read whether a trial is finished, with the errors of `read`."""
        path = log_path(self.folder, trial)
        if not path.exists():
            return
        try:
            found = read_result(path)
        except LogError:
            return
        self._check(found)
        if self._finished(found):
            self.results[trial] = found

    def _finished(self, found: ResultSummary) -> bool:
        aborts_again = (
            found.outcome is Outcome.ABORTED
            and found.code == self.code
            and not self.experiment.plant.real_time
        )
        return not found.recovered and (found.outcome.complete or aborts_again)

    def _check(self, found: ResultSummary) -> None:
        experiment = found.experiment
        if self.experiment.open:  # each trial chose its own robots
            own = {"robots": self.experiment.robots, "chosen": self.experiment.chosen}
            experiment = experiment.model_copy(update=own)
        if arm_hash(experiment) != self.hash:
            raise UsageError(
                f"{found.path}: was run with another spec or seed",
                "name another folder with --out, or give the spec and seed of this trial",
            )


class Store:
    """The folder of a run with the folders of its batches, by arm: those of a study, or one named
    "", the folder itself.
    """

    def __init__(self, folder: Path, batches: Mapping[str, BatchFolder]) -> None:
        self.folder, self.batches = folder, batches

    @classmethod
    def of_batch(cls, folder: Path, experiment: Experiment) -> "Store":
        """Return the store of a batch."""
        return cls(folder, {"": BatchFolder(folder, experiment)})

    @property
    def lacking(self) -> list[int]:
        """The trials of a batch that are not finished."""
        return self.batches[""].lacking

    @contextmanager
    def opened(self, resume: bool = True) -> Iterator[None]:
        """Create and lock the folder, and read which trials are finished.

        Raises the errors of `read` and `locked`.
        """
        self._check(resume)  # checked first, so that a refused run creates no folder
        with locked(self.folder):
            self.read(resume)
            yield

    def read(self, resume: bool = True) -> None:
        """Read which trials are finished, with the errors of `BatchFolder.read`.

        Raises UsageError for a folder with trials unless they are to `resume`.
        """
        self._check(resume)
        for batch in self.batches.values():
            batch.read()

    def _check(self, resume: bool) -> None:
        if self.folder.exists() and not self.folder.is_dir():
            raise UsageError(f"{self.folder}: not a folder", "name another with --out")
        names = () if resume or not self.folder.exists() else self.folder.iterdir()
        if any(path.name.endswith((SUFFIX, LOG_PART)) for path in names):
            raise UsageError(
                f"{self.folder}: holds logs already",
                "name another folder with --out, or add --resume",
            )

    def place(self, arm: str, trial: int) -> Path:
        """Rename logs of earlier attempts of a trial, as `set_aside` does; return the folder for
        its log."""
        folder = self.batches[arm].folder
        make_folder(folder)
        set_aside(folder, trial)
        return folder

    def add(self, arm: str, trial: int) -> None:
        """Read the log of a trial that has ended."""
        self.batches[arm].read_trial(trial)


class RecordStore:
    """The folder of what is computed by number and is no trial with a log, such as the days of a
    rehearsal: a JSON file for each number, written whole.

    `identity` says of what they are, and each record has at least `fields`. A file that cannot be
    read does not count, as a damaged log does not: what it was of is computed again.
    """

    def __init__(self, folder: Path, identity: str, fields: Collection[str]) -> None:
        self.folder, self._identity, self._fields = folder, identity, fields
        self.records: dict[int, dict[str, Any]] = {}

    @contextmanager
    def opened(self) -> Iterator[None]:
        """Create and lock the folder, and read its records.

        Raises UsageError if the folder is a file or has records of another identity, and the errors
        of `locked`.
        """
        if any(
            place.exists() and not place.is_dir() for place in (self.folder, *self.folder.parents)
        ):
            raise UsageError(f"{self.folder}: not a folder", "name another with --out")
        with locked(self.folder):
            for path in self.folder.glob("record-*.json"):
                if (record := self._read(path)) is not None:
                    self.records[int(path.stem.removeprefix("record-"))] = record
            yield

    def _read(self, path: Path) -> dict[str, Any] | None:
        """Return the record in a file; None if it cannot be read."""
        try:
            stated = json.loads(path.read_bytes())
            identity, record = stated["of"], stated["record"]
            known = record.keys() >= set(self._fields)
        except (AttributeError, KeyError, OSError, RecursionError, TypeError, ValueError):
            return None
        if identity != self._identity:
            hint = (
                "give another --out: a folder has records of one spec, with its --set, and one seed"
            )
            raise UsageError(f"{path}: is of another spec, seed or settings", hint)
        return record if known else None

    def add(self, number: int, record: Mapping[str, Any]) -> None:
        """Write a record; LogError if that fails."""
        text = json.dumps({"of": self._identity, "record": dict(record)})
        save_whole(self.folder / f"record-{number:06d}.json", text.encode())
        self.records[number] = dict(record)


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

"""The folder of a run: its lock, the logs of its trials, and the list of finished trials.

A batch is a folder with the logs of one experiment's trials. A study is a folder of batches, its
arms. Both are a `Store`. First it is `opened`, which locks the folder and reads which trials are
finished. For each trial that is run, `place` then returns the folder of its log, and `add` reads
the log. A `RecordStore` is a folder of numbered records that are not trials.
"""

import itertools
import json
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tetractl.core.errors import LogError, UsageError
from tetractl.core.plan import Outcome
from tetractl.log.read.find import LOG_PART, RECOVERED_SUFFIX, SUFFIX, attempt_name
from tetractl.log.read.reader import read_result
from tetractl.log.read.trial_log import ResultSummary
from tetractl.run.folder_lock import locked
from tetractl.run.logged_trial import log_path
from tetractl.run.task import code_hash
from tetractl.spec.experiment import Experiment
from tetractl.spec.loaded_spec import arm_hash
from tetractl.tools.files import make_folder, write_atomically


class BatchFolder:
    """The folder of the trials of one experiment.

    A trial is finished if its log is complete, and if it was neither interrupted nor aborted. An
    aborted trial in virtual time also counts as finished if the same code has run it, because it
    would be aborted again. `run --resume` and studies run all other trials.

    Attributes:
        folder: Path of the folder.
        experiment: The experiment.
        code_hash: Hash of the code that would run the trials now.
        spec_hash: Hash of the experiment without the number of trials.
        results: The results of the finished trials, by the index of the trial.
    """

    def __init__(self, folder: Path, experiment: Experiment) -> None:
        self.folder = folder
        self.experiment = experiment
        self.code_hash = code_hash(experiment)
        self.spec_hash = arm_hash(experiment)
        self.results: dict[int, ResultSummary] = {}

    @property
    def unfinished(self) -> list[int]:
        """The indices of the trials that are not finished."""
        trials = range(self.experiment.trials.count)
        return [trial for trial in trials if trial not in self.results]

    @property
    def outdated(self) -> list[int]:
        """The indices of the finished trials that another version of the code has run."""
        return [trial for trial, result in self.results.items() if result.code != self.code_hash]

    def read(self) -> None:
        """Find out which trials are finished. Damaged or incomplete logs do not count.

        Raises:
            UsageError: If a trial has another spec or seed. Only the number of trials may differ.
        """
        self.results = {}
        for trial in range(self.experiment.trials.count):
            self.read_trial(trial)

    def read_trial(self, trial: int) -> None:
        """Find out whether a trial is finished, and keep its result if it is.

        A missing or damaged log does not count. The errors are the same as for `read`.
        """
        path = log_path(self.folder, trial)
        if not path.exists():
            return
        try:
            result = read_result(path)
        except LogError:
            return
        self._check(result)
        aborts_again = (
            result.outcome is Outcome.ABORTED
            and result.code == self.code_hash
            and not self.experiment.plant.real_time
        )
        if not result.recovered and (result.outcome.complete or aborts_again):
            self.results[trial] = result

    def _check(self, result: ResultSummary) -> None:
        """Check that a result comes from the spec and the seed of this folder.

        Raises:
            UsageError: If it comes from another spec or seed.
        """
        experiment = result.experiment
        if self.experiment.must_choose_robots:  # each trial chose its own robots
            spec_robots = {"robots": self.experiment.robots, "chosen": self.experiment.chosen}
            experiment = experiment.model_copy(update=spec_robots)
        if arm_hash(experiment) != self.spec_hash:
            raise UsageError(
                f"{result.log}: this trial was run with another spec or seed",
                "name another folder with --out, or give the spec and seed of this trial",
                "name another folder with folder=, or give the spec and seed of this trial",
            )


class Store:
    """The folder with the logs of a run or, for a study, one such folder for each arm.

    For a single batch, the arm is named "", and its folder is the folder itself.
    """

    def __init__(self, folder: Path, batches: Mapping[str, BatchFolder]) -> None:
        self.folder = folder
        self.batches = batches

    @classmethod
    def of_batch(cls, folder: Path, experiment: Experiment) -> "Store":
        """Return the store of a single batch, a folder with the logs of one spec."""
        return cls(folder, {"": BatchFolder(folder, experiment)})

    @property
    def unfinished(self) -> list[int]:
        """The indices of a batch's trials that are not finished."""
        return self.batches[""].unfinished

    @property
    def aborted(self) -> list[int]:
        """The indices of a batch's finished trials that were aborted (see `BatchFolder`)."""
        results = self.batches[""].results
        return [trial for trial, r in results.items() if r.outcome is Outcome.ABORTED]

    @contextmanager
    def opened(self, resume: bool = True) -> Iterator[None]:
        """Create the folder, lock it during the `with` block, and find the finished trials.

        The errors are the same as for `read` and `locked`.

        Args:
            resume: Whether the folder may already contain logs.
        """
        self._check(resume)  # checked first, so that a refused run creates no folder
        with locked(self.folder):
            self.read(resume)
            yield

    def read(self, resume: bool = True) -> None:
        """Find out which trials are finished.

        Args:
            resume: Whether the folder may already contain logs.

        Raises:
            UsageError: If the folder is a file, if it contains logs although `resume` is False, or
                if a trial has another spec or seed.
        """
        self._check(resume)
        for batch in self.batches.values():
            batch.read()

    def _check(self, resume: bool) -> None:
        """Check that the folder can be used for this run.

        Raises:
            UsageError: If the folder is a file, or if it has logs that are not to be resumed.
        """
        if not self.folder.exists():
            return
        if not self.folder.is_dir():
            raise UsageError(
                f"{self.folder}: this is not a folder",
                "choose another folder with --out",
                "choose another folder with folder=",
            )
        if resume:
            return
        if any(path.name.endswith((SUFFIX, LOG_PART)) for path in self.folder.iterdir()):
            raise UsageError(
                f"{self.folder}: this folder holds logs already",
                "name another folder with --out, or add --resume",
                "name another folder with folder=, or add resume=True",
            )

    def prepare_folder(self, arm: str, trial: int) -> Path:
        """Rename the logs of earlier attempts at a trial, and return the folder for its log."""
        folder = self.batches[arm].folder
        make_folder(folder)
        set_aside_logs(folder, trial)
        return folder

    def add_result(self, arm: str, trial: int) -> None:
        """Read the log of a trial that has ended, and keep its result."""
        self.batches[arm].read_trial(trial)


class RecordStore:
    """A folder of numbered records that are not trials, such as the test runs of a rehearsal.

    Each record is a JSON file, which is written completely or not at all. A file that cannot be
    read does not count, and its record is computed again.

    Args:
        folder: The folder.
        identity: Describes what the records belong to.
        fields: Names of the fields that each record must have.

    Attributes:
        records: The records, by number.
    """

    def __init__(self, folder: Path, identity: str, fields: Collection[str]) -> None:
        self.folder = folder
        self._identity = identity
        self._fields = fields
        self.records: dict[int, dict[str, Any]] = {}

    @contextmanager
    def opened(self) -> Iterator[None]:
        """Create and lock the folder, and read its records, for a `with` block.

        Raises:
            UsageError: If the folder is a file or has records of another identity. `locked` raises
                further errors.
        """
        for folder in (self.folder, *self.folder.parents):
            if folder.exists() and not folder.is_dir():
                raise UsageError(
                    f"{self.folder}: this is not a folder", "choose another folder with --out"
                )
        with locked(self.folder):
            for path in self.folder.glob("record-*.json"):
                record = self._read(path)
                if record is not None:
                    number = int(path.stem.removeprefix("record-"))
                    self.records[number] = record
            yield

    def _read(self, path: Path) -> dict[str, Any] | None:
        """Read the record in a file.

        The result is None if the file cannot be read or lacks a field.

        Raises:
            UsageError: If the record has another identity.
        """
        try:
            contents = json.loads(path.read_bytes())
            identity = contents["of"]
            record = contents["record"]
            is_complete = record.keys() >= set(self._fields)
        except (AttributeError, KeyError, OSError, RecursionError, TypeError, ValueError):
            return None
        if identity != self._identity:
            hint = (
                "choose another folder with --out: a folder can hold the trials of only one "
                "spec, with its --set, and one seed"
            )
            raise UsageError(
                f"{path}: this result comes from a trial with another "
                "spec, other settings or another seed",
                hint,
            )
        return record if is_complete else None

    def add_record(self, number: int, record: Mapping[str, Any]) -> None:
        """Write the record with this number to its file.

        Raises:
            LogError: If the file cannot be written.
        """
        record_json = json.dumps({"of": self._identity, "record": dict(record)})
        write_atomically(self.folder / f"record-{number:06d}.json", record_json.encode())
        self.records[number] = dict(record)


def set_aside_logs(folder: Path, trial: int) -> None:
    """Rename earlier logs of a trial that is to be run, to trial-003.attempt-1.mcap and so on.

    No earlier attempt is overwritten. A recovered log gets the attempt number of its source.
    """
    path = log_path(folder, trial)
    recovered = path.with_suffix(RECOVERED_SUFFIX)
    for log in (path, path.with_name(path.name + ".part")):
        if log.exists():
            number = _next_attempt(folder, log)
            _rename_attempt(log, number)
            if recovered.exists():
                _rename_attempt(recovered, number)


def _next_attempt(folder: Path, log: Path) -> int:
    """Find the first attempt number, from 1, for which the folder has no file of a trial yet."""
    stem = log.name.partition(SUFFIX)[0]
    names = [path.name for path in folder.iterdir()]
    for number in itertools.count(1):
        if not any(name.startswith(f"{stem}.attempt-{number}.") for name in names):
            return number
    raise AssertionError("counting does not end")


def _rename_attempt(log: Path, number: int) -> None:
    """Rename the log of an earlier attempt, so that its name contains `number`."""
    new_path = log.with_name(attempt_name(log.name, number))
    new_path.touch(exist_ok=False)  # reserves the name
    log.replace(new_path)

"""The folder of a run: its lock, the logs and rows of its trials, and which trials are missing.

A batch is a folder with the logs of the trials of one experiment. A study is a folder of batches,
its arms, in which each trial also has a row, with or without a log.
"""

import itertools
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from tetractl.core.errors import LogError, UsageError, printable
from tetractl.core.files import save_whole
from tetractl.core.plan import Outcome
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.load import arm_hash, resolved_yaml
from tetractl.log.format.channels import RESOLVED_SPEC, TEXT
from tetractl.log.read.find import LOG_PART, RECOVERED_SUFFIX, ROWS, SUFFIX, attempt_name
from tetractl.log.read.reader import read_result
from tetractl.run.folder_lock import locked, make_folder
from tetractl.run.rows import Row, cut_to_lines, read_rows, simulated
from tetractl.run.task import Finished, Task, log_path


def default_folder(name: str, now: datetime) -> Path:
    """Return logs/<spec name>-<UTC time>."""
    return Path("logs") / f"{name}-{now:%Y%m%dT%H%M%SZ}"


class BatchFolder:
    """The folder of the trials of one experiment; `rows` are its finished trials by number.

    A trial is finished if it has a row in the file of rows, or a complete log: then its row is made
    from the log. All others are run, by `run --resume` as by a study. With `code`, the hash of the
    code that runs the trials, each trial that is added leaves a row; without, its log is its only
    record.
    """

    def __init__(self, folder: Path, experiment: Experiment, code: str = "") -> None:
        self.folder, self.experiment, self.code = folder, experiment, code
        self.hash = arm_hash(experiment)
        self.rows: dict[int, Row] = {}
        self._spec_written = False

    @property
    def lacking(self) -> list[int]:
        """The numbers of the trials that are not finished."""
        return [n for n in range(self.experiment.trials.count) if n not in self.rows]

    @property
    def outdated(self) -> list[int]:
        """The numbers of the finished trials that another version of the code has run."""
        count = self.experiment.trials.count
        return [n for n, row in self.rows.items() if n < count and row.code != self.code]

    def read(self, mend: bool = False) -> None:
        """Read which trials are finished; damaged rows, and logs that are damaged or incomplete, do
        not count.

        With `mend` the file of rows is cut after its last complete line, which a killed process may
        have left. Raises UsageError if trials are of another spec or seed (only their number may
        differ), LogError if the rows cannot be read.
        """
        path = self.folder / ROWS
        self.rows = {}
        if path.exists():
            if mend:
                cut_to_lines(path)
            found = read_rows(path, self.experiment)
            self.rows = {trial: row for trial, row in found.items() if row is not None}
            for row in self.rows.values():
                self._check(row.path, row.arm_hash)
            if mend and self.rows:
                self.prepare()
        for trial in self.lacking:
            if (row := self._of_log(log_path(self.folder, trial))) is not None:
                self.rows[trial] = row

    def _of_log(self, path: Path) -> Row | None:
        """Return the row of a complete log; None for any other, and if there is none."""
        if not path.exists():
            return None
        try:
            found = read_result(path)
        except LogError:
            return None
        experiment = found.experiment
        if self.experiment.open:  # each trial chose its own robots
            own = {"robots": self.experiment.robots, "chosen": self.experiment.chosen}
            experiment = experiment.model_copy(update=own)
        self._check(str(path), arm_hash(experiment))
        return Row.of(found, self.hash) if found.outcome.complete and not found.recovered else None

    def _check(self, place: str, known_by: str) -> None:
        if known_by != self.hash:
            raise UsageError(
                f"{place}: was run with another spec or seed",
                "name another folder with --out, or give the spec and seed of this trial",
            )

    def prepare(self) -> None:
        """Create the folder; if its trials leave rows, with the spec, by which rows are read."""
        if self.code and not self._spec_written:
            make_folder(self.folder)
            save_whole(self.folder / RESOLVED_SPEC, resolved_yaml(self.experiment).encode())
            self._spec_written = True

    def add(self, task: Task, finished: Finished) -> None:
        """Store the record of a finished trial. A study's trial that was interrupted leaves neither
        row nor log."""
        if not self.code:
            return
        if finished.result.outcome is Outcome.INTERRUPTED:
            log_path(self.folder, task.trial).unlink(missing_ok=True)
            return
        result = finished.result
        row = Row(
            **simulated(self.experiment),
            path=str(self.folder / ROWS),
            trial=task.trial,
            arm_hash=self.hash,
            code=self.code,
            processor=finished.processor,
            digest=finished.digest,
            count=task.count,
            logged=finished.logged,
            wall_s=finished.wall_s,
            cpu_s=finished.cpu_s,
            warnings=finished.warnings,
            result=replace(result, reason=printable(result.reason, TEXT)),
        )
        self.add_row(row)

    def add_row(self, row: Row) -> None:
        """Add a row, in memory and, as one line, on disk."""
        self.prepare()
        self.rows[row.trial] = row
        path = self.folder / ROWS
        try:
            with path.open("a", encoding="utf-8") as file:
                file.write(row.line())
        except OSError as error:
            raise LogError(f"{path}: cannot be written: {error.strerror}") from error


class Store:
    """The folder of a run with the folders of its batches, by arm: those of a study, or one named
    "", the folder itself.
    """

    def __init__(self, folder: Path, batches: Mapping[str, BatchFolder]) -> None:
        self.folder, self.batches = folder, batches

    @classmethod
    def of_batch(cls, folder: Path, experiment: Experiment) -> "Store":
        """Return the store of a batch, whose logs are its only record."""
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
            self.read(resume, mend=True)
            yield

    def read(self, resume: bool = True, mend: bool = False) -> None:
        """Read which trials are finished, with the errors of `BatchFolder.read`.

        Raises UsageError for a folder with trials unless they are to `resume`.
        """
        self._check(resume)
        for batch in self.batches.values():
            batch.read(mend)

    def _check(self, resume: bool) -> None:
        if self.folder.exists() and not self.folder.is_dir():
            raise UsageError(f"{self.folder}: not a folder", "name another with --out")
        names = () if resume or not self.folder.exists() else self.folder.iterdir()
        if any(path.name.endswith((SUFFIX, LOG_PART, ROWS)) for path in names):
            raise UsageError(
                f"{self.folder}: holds logs already",
                "name another folder with --out, or add --resume",
            )

    def place(self, arm: str, trial: int) -> Path:
        """Rename logs of earlier attempts of a trial, as `set_aside` does; return the folder for
        its log."""
        batch = self.batches[arm]
        batch.prepare()
        set_aside(batch.folder, trial)
        return batch.folder

    def add(self, task: Task, finished: Finished) -> None:
        """Store the record of a finished trial."""
        self.batches[task.arm].add(task, finished)


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

"""The folder of a study: for each arm, a folder with a file of its trials' rows, and logs."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from tetractl.core.errors import LogError, UsageError, printable
from tetractl.core.files import save_whole
from tetractl.core.plan import Outcome
from tetractl.experiment.load import resolved_yaml
from tetractl.log.format.channels import RESOLVED_SPEC, TEXT
from tetractl.log.read.find import ROWS
from tetractl.log.read.rows import Row, check_rows, read_rows
from tetractl.run.store import TrialFolder, locked, make_folder
from tetractl.run.task import Finished, Task, log_path
from tetractl.study.load_study import Arm


class Store(TrialFolder):
    """The rows of a study by arm and trial; each is written to disk as soon as it is added.

    A row is one line. An incomplete line, left by a killed process, is dropped when the folder is
    opened. If a trial has two lines, the later one is used.
    """

    def __init__(self, folder: Path, arms: Sequence[Arm]) -> None:
        super().__init__(folder)
        self.rows = {arm.name: dict[int, Row]() for arm in arms}
        self._arms = {arm.name: arm for arm in arms}
        self._placed: set[str] = set()  # names of arms whose folder already has the arm's spec

    @contextmanager
    def opened(self) -> Iterator[None]:
        """Create and lock the folder, and read its rows.

        Raises UsageError if another run holds the lock, or if the rows belong to another study.
        """
        with locked(self.folder):
            self.read(mend=True)
            for arm in self._arms:
                if self.rows[arm]:
                    self.arm_folder(arm)
            yield

    def read(self, mend: bool = False) -> None:
        """Read the rows of the folder; `mend` as in `rows_of`."""
        self.rows = {arm.name: rows_of(self.folder, arm, mend) for arm in self._arms.values()}

    def arm_folder(self, arm: str) -> Path:
        """Return the folder of an arm; if it is missing, create it with the arm's spec."""
        folder = self.folder / arm
        if arm not in self._placed:
            make_folder(folder)
            save_whole(
                folder / RESOLVED_SPEC, resolved_yaml(self._arms[arm].spec.experiment).encode()
            )
            self._placed.add(arm)
        return folder

    def add(self, task: Task, finished: Finished) -> None:
        """Add the row of a finished trial; for an interrupted trial, delete its log instead."""
        arm, result = self._arms[task.arm], finished.result
        path = log_path(self.folder / arm.name, task.trial)
        if result.outcome is Outcome.INTERRUPTED:
            path.unlink(missing_ok=True)
            return
        row = Row(
            trial=task.trial,
            arm_hash=arm.hash,
            code=arm.code,
            processor=finished.processor,
            content_digest=finished.digest,
            count=task.count,
            logged=finished.logged,
            wall_s=finished.wall_s,
            cpu_s=finished.cpu_s,
            warnings=finished.warnings,
            result=replace(result, reason=printable(result.reason, TEXT)),
            place=str(self.folder / arm.name / ROWS),
        )
        self.add_row(arm, row)

    def add_row(self, arm: Arm, row: Row) -> None:
        """Add a row, in memory and on disk."""
        self.rows[arm.name][row.trial] = row
        path = self.arm_folder(arm.name) / ROWS
        try:
            with path.open("a", encoding="utf-8") as file:
                file.write(row.line(arm.spec.experiment))
        except OSError as error:
            raise LogError(f"{path}: cannot be written: {error.strerror}") from error


def rows_of(folder: Path, arm: Arm, mend: bool = False) -> dict[int, Row]:
    """Return the rows of an arm by trial; damaged rows are left out, so that their trials are run
    again.

    With `mend` the file is cut after its last complete line. Raises UsageError for rows of another
    spec, LogError if the file cannot be read.
    """
    path = folder / arm.name / ROWS
    if not path.exists():
        return {}
    check_rows(path)
    if mend:
        _cut_to_lines(path)
    found = read_rows(path, arm.spec.experiment)
    for row in found.values():
        if row is not None and row.arm_hash != arm.hash:
            raise UsageError(
                f"{row.place}: was run with another spec or seed",
                "name another folder with --out, or use the study that wrote the row",
            )
    return {trial: row for trial, row in found.items() if row is not None}


def _cut_to_lines(path: Path) -> None:
    try:
        with path.open("r+b") as file:
            text = file.read()
            whole = text.rfind(b"\n") + 1
            if whole < len(text):
                file.truncate(whole)
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error

"""The folder of a study: a folder an arm, with the rows of its trials and the logs kept."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from tetractl.core.errors import LogError, UsageError
from tetractl.experiment.load import resolved_yaml
from tetractl.log.read.find import ROWS
from tetractl.log.read.rows import SPEC
from tetractl.run.batch import log_path
from tetractl.run.folder import make_folder, set_aside
from tetractl.run.folder_lock import locked
from tetractl.study.arm import Arm
from tetractl.study.row import Row


class Store:
    """The rows of a study by arm and trial, on disk as they come.

    A row is one line; what a killed process left of a line is dropped when the folder is opened.
    Of two lines of a trial the later counts.
    """

    def __init__(self, folder: Path, arms: Iterable[Arm]) -> None:
        self.folder = folder
        self.rows: dict[str, dict[int, Row]] = {arm.name: {} for arm in arms}
        self._placed: set[str] = set()  # arms whose folder is known to hold their spec

    @contextmanager
    def opened(self, arms: Iterable[Arm]) -> Iterator[None]:
        """Make the folder, lock it, and read what is in it.

        Raises UsageError where another run has the lock, or rows are of another study.
        """
        make_folder(self.folder)
        with locked(self.folder):
            for arm in arms:
                self.rows[arm.name] = read_rows(self.folder, arm, mend=True)
                if self.rows[arm.name]:
                    self.place(arm)
            yield

    def place(self, arm: Arm) -> Path:
        """Return the folder of an arm, made if need be, with the spec of its rows."""
        folder = self.folder / arm.name
        if arm.name not in self._placed:
            make_folder(folder)
            text = resolved_yaml(arm.spec.experiment)
            if _text_of(folder / SPEC) != text:
                _save(folder / SPEC, text)
            self._placed.add(arm.name)
        return folder

    def clear(self, arm: Arm, trial: int) -> Path:
        """Return the folder of an arm, logs of a trial that is to be run set aside."""
        folder = self.place(arm)
        path = log_path(folder, trial)
        if path.exists() or path.with_name(path.name + ".part").exists():
            set_aside(folder, trial)
        return folder

    def add(self, arm: Arm, row: Row) -> None:
        """Add the row of a trial, in memory and on disk."""
        self.rows[arm.name][row.trial] = row
        _append(self.place(arm) / ROWS, row.line())


def read_rows(folder: Path, arm: Arm, mend: bool = False) -> dict[int, Row]:
    """Return the rows of an arm by trial; lines that are none are passed over.

    With `mend` the file is cut after its last whole line. Raises UsageError for rows of another
    spec, LogError where the file cannot be read.
    """
    path = folder / arm.name / ROWS
    try:
        text = path.read_bytes()
        whole = text.rfind(b"\n") + 1
        if mend and whole < len(text):
            with path.open("r+b") as file:
                file.truncate(whole)
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error
    rows: dict[int, Row] = {}
    for line in text[:whole].decode(errors="replace").split("\n")[:-1]:
        try:
            row = Row.read(line)
        except (ValueError, TypeError):
            continue  # the trial is run again
        if row.arm_hash != arm.hash:
            raise UsageError(
                f"{path}: was run with another spec or seed",
                "name another folder with --out, or the study it was run with",
            )
        rows[row.trial] = row
    return rows


def merge(store: Store, arms: Iterable[Arm], folders: Iterable[Path]) -> int:
    """Add the rows and logs of other folders of the same study; return how many rows were added.

    Of a trial that both have, the row here stays, unless only the other has the log of the same
    digest. Logs are linked where the file system can, else copied. Raises UsageError for a folder
    without a row of the study, and for two rows of a trial by the same code that differ.
    """
    added = 0
    for folder in folders:
        found = {arm.name: read_rows(folder, arm) for arm in arms}
        if not any(found.values()):
            raise UsageError(f"{folder}: holds no trial of this study")
        for arm in arms:
            added += sum(_take(store, arm, folder, row) for row in found[arm.name].values())
    return added


def _take(store: Store, arm: Arm, folder: Path, row: Row) -> bool:
    mine: Mapping[int, Row] = store.rows[arm.name]
    twin = mine.get(row.trial)
    if twin is not None:
        alike = (twin.code, twin.count) == (row.code, row.count)
        if alike and twin.trial_digest != row.trial_digest:
            raise UsageError(
                f"{folder}: trial {row.trial} of {arm.name} differs from that in {store.folder},"
                " by the same code",
                "were they run on processors of different types?",
            )
        if twin.logged or not row.logged or twin.trial_digest != row.trial_digest:
            return False
    if row.logged:
        source = log_path(folder / arm.name, row.trial)
        keep_log(log_path(store.clear(arm, row.trial), row.trial), source)
    store.add(arm, row)
    return True


def keep_log(path: Path, source: Path) -> None:
    """Give a log a second name, or copy it where that cannot be; LogError where neither can."""
    try:
        try:
            path.hardlink_to(source)
        except OSError:
            save_whole(path, source.read_bytes())
    except OSError as error:
        raise LogError(f"{source}: cannot be copied: {error.strerror}") from error


def save_whole(path: Path, data: bytes) -> None:
    """Write a file, such as a log that was made elsewhere, whole or not at all."""
    part = path.with_name(path.name + ".part")
    part.write_bytes(data)
    part.replace(path)


def _save(path: Path, text: str) -> None:
    """Give a file a text, whole or not at all; LogError where it cannot be written."""
    try:
        save_whole(path, text.encode())
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error.strerror}") from error


def _text_of(path: Path) -> str | None:
    """Return what is in a file, None where nothing can be read."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return None


def _append(path: Path, text: str) -> None:
    try:
        with path.open("a", encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error.strerror}") from error

"""The folder of a rehearsal: `days.jsonl` has a line for each day played, `days-of.txt` says of
which days they are."""

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from tetractl.core.errors import LogError, UsageError
from tetractl.core.files import save_whole
from tetractl_emulator.rehearsal.summary import DayRow

MARK = "days-of.txt"
RESULTS = "days.jsonl"
FIELDS = {"day", "digest", "seconds", "ended", "reason", "met", "violations"}


class KeptDays:
    """The days of `identity` that a folder has, which is made if it is missing.

    UsageError if the folder is a file, or has days of another identity; LogError if it cannot be
    written. A line that cannot be read, as after a power cut, is left out: `unread` are its
    numbers, and its day is to be played again.
    """

    def __init__(self, folder: Path, identity: str) -> None:
        self.folder = folder
        self.rows: dict[int, DayRow] = {}
        self.unread: list[int] = []
        self._path = folder / RESULTS
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _claim(folder, identity)
            lines = self._path.read_bytes().splitlines() if self._path.exists() else []
        except (FileExistsError, NotADirectoryError):
            raise UsageError(f"{folder}: is not a folder", "give another --out") from None
        except OSError as error:
            raise _unwritable(folder, error) from error
        for number, line in enumerate(lines, 1):
            row = _row(line)
            if row is None:
                self.unread.append(number)
            else:
                self.rows[row["day"]] = row
        if self.unread:  # what is added next begins a line
            text = "".join(json.dumps(row) + "\n" for row in self.rows.values())
            save_whole(self._path, text.encode())

    def add(self, row: DayRow) -> None:
        """Write a day's row; LogError if that fails."""
        try:
            with self._path.open("a") as file:
                file.write(json.dumps(row) + "\n")
        except OSError as error:
            raise _unwritable(self._path, error) from error
        self.rows[row["day"]] = row


def _claim(folder: Path, identity: str) -> None:
    """Mark a folder as that of the days of `identity`; UsageError if it has others."""
    mark = folder / MARK
    if not mark.exists():
        mark.write_text(identity)
    elif mark.read_bytes() != identity.encode():
        hint = "give another --out: a folder has the days of one spec, with its --set, and one seed"
        raise UsageError(f"{folder} has days of another spec, seed or settings", hint)


def _row(line: bytes) -> dict[str, Any] | None:
    """Return the row of a line; None if it has another form."""
    with suppress(ValueError, RecursionError):
        row = json.loads(line)
        if isinstance(row, Mapping) and row.keys() >= FIELDS and isinstance(row["day"], int):
            return dict(row)
    return None


def _unwritable(path: Path, error: OSError) -> LogError:
    return LogError(f"{error.filename or path}: cannot be written: {error.strerror or error}")

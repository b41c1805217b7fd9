"""Write tables for other programs: JSON, and CSV that follows RFC 4180.

R, MATLAB and spreadsheets can read the CSV files. Numbers have all their digits, truth values are
true and false, infinities are inf and -inf, and unknown values (None and NaN) are empty. Text that
a spreadsheet would evaluate as a formula gets an apostrophe in front. In JSON, a non-finite number
is null.
"""

import csv
import io
import json
import math
import unicodedata
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, TextIO

from tetractl.core.errors import LogError, UsageError, printable
from tetractl.tools.table.table import Array, Table

PART_ENDING = ".part"
"""Ending of a file that is not complete yet."""
COLUMNS_NAMED = 4
"""Maximum number of columns that are named in an error."""
AddRows = Callable[[str, Table, str], None]
"""Function that adds rows to the file of a name; the text is their source, for messages."""


def format_csv(table: Table) -> str:
    """Format a table as text in the CSV format, without its title and its note."""
    stream = io.StringIO()
    _write_header(table, stream)
    _write_rows(table, stream)
    return stream.getvalue()


def _write_header(table: Table, stream: TextIO) -> None:
    csv.writer(stream, lineterminator="\n").writerow(
        format_csv_entry(column.key) for column in table.columns
    )


def _write_rows(table: Table, stream: TextIO) -> None:
    columns = [_format_cells(column.listed) for column in table.columns]
    csv.writer(stream, lineterminator="\n").writerows(zip(*columns, strict=True))


def _format_cells(values: Sequence[Any]) -> list[str]:
    """Format the values of a column as entries of a CSV file. None and NaN become empty entries."""
    from pydantic_core import to_json  # slow to import, and not needed by most commands

    def format_cell(value: Any) -> str:
        if value is None or value != value:
            return ""
        if isinstance(value, bool):
            return "true" if value else "false"
        if isinstance(value, float):
            # digits as in JSON, 0.00001 instead of 1e-05, at twice the speed of repr
            if not math.isfinite(value):
                return str(value)
            return to_json(value).decode()
        if isinstance(value, str):
            return format_csv_entry(value)
        return str(value)

    return [format_cell(value) for value in values]


@lru_cache  # columns repeat their words
def format_csv_entry(text: str) -> str:
    """Format text as an entry of a CSV file, safely for spreadsheets.

    A spreadsheet evaluates text as a formula if it begins with =, +, - or @, even after white space
    or as full-width signs. An apostrophe in front prevents that.
    """
    printable_text = printable(text)
    first_character = unicodedata.normalize("NFKC", text).lstrip()[:1]
    return (
        f"'{printable_text}"
        if text[:1] in ("\t", "\r") or first_character in ("=", "+", "-", "@")
        else printable_text
    )


@contextmanager
def open_table_files(paths: Mapping[str, Path]) -> Iterator[AddRows]:
    """Write the CSV files of several tables, and yield the function that adds rows to them.

    That function raises UsageError if the columns differ from those of earlier rows. Each file is
    written as NAME.part, and renamed at the end of the `with` block unless there was an error; then
    folders that were made for them are deleted. A file without rows is empty.
    """
    files = {name: _GrowingFile(name, path) for name, path in paths.items()}
    folders = {folder for path in paths.values() for folder in path.parents}
    missing_folders = [folder for folder in folders if not folder.exists()]
    missing_folders.sort(key=lambda folder: len(folder.parts), reverse=True)  # the innermost first

    def add(name: str, table: Table, source: str) -> None:
        files[name].add(table, source)

    try:
        with ExitStack() as stack:
            for file in files.values():
                stack.enter_context(file.open())
            yield add
        for file in files.values():
            file.complete()
    finally:
        for file in files.values():
            file.discard()
        for folder in missing_folders:
            with suppress(OSError):  # it holds the complete files, or was not made
                folder.rmdir()


class _GrowingFile:
    """The CSV file of one table, to which rows are added while it is open.

    Call `open`, then `add` for the rows, then `complete`. Until then, the file is called
    NAME.part, which `discard` deletes. If the file cannot be written, LogError is raised.
    """

    def __init__(self, name: str, path: Path) -> None:
        self._name = name
        self._path = path
        self._part_path = path.with_name(path.name + PART_ENDING)
        self._keys: list[str] | None = None  # of the columns; None before the first rows
        self._stream: TextIO | None = None

    @contextmanager
    def open(self) -> Iterator[None]:
        """Create the file under a temporary name, and close it at the end of the `with` block.

        Its folder is created if it is missing.
        """
        with self._convert_errors():
            self._part_path.parent.mkdir(parents=True, exist_ok=True)
            self._stream = self._part_path.open("w", encoding="utf-8", newline="")
        try:
            yield
        finally:
            with self._convert_errors():
                self._stream.close()

    def add(self, table: Table, source: str) -> None:
        """Write the rows of a table. The first rows are preceded by the header.

        Raises:
            UsageError: If the columns differ from those of the first table. It names the `source`.
            LogError: If the file cannot be written.
        """
        assert self._stream is not None, "rows are added to an open file"
        column_keys = [column.key for column in table.columns]
        with self._convert_errors():
            if self._keys is None:
                self._keys = column_keys
                _write_header(table, self._stream)
            if column_keys != self._keys:
                differing_keys = sorted(set(column_keys) ^ set(self._keys))
                raise UsageError(
                    f"{source}: the columns of the table {self._name} differ from those of "
                    f"earlier logs: {', '.join(differing_keys[:COLUMNS_NAMED])}",
                    "export the logs of each experiment separately",
                )
            _write_rows(table, self._stream)

    def complete(self) -> None:
        """Give the finished file its final name, in place of an existing file."""
        with self._convert_errors():
            self._part_path.replace(self._path)

    def discard(self) -> None:
        """Delete the file if it was not completed."""
        with self._convert_errors():
            self._part_path.unlink(missing_ok=True)

    @contextmanager
    def _convert_errors(self) -> Iterator[None]:
        """Raise LogError if an error occurs while the file is written, such as a full disk."""
        try:
            yield
        except OSError as error:
            path = error.filename or self._part_path
            raise LogError(f"{path}: the table cannot be written: {error.strerror}") from error


def format_json(value: Any, indent: int | None = 2) -> str:
    """Convert plain data, dataclasses and arrays to JSON. Non-finite numbers become null.

    `indent` is the number of blanks per level. With None, the text is one line of ASCII.
    """
    return json.dumps(
        convert_to_plain(value), indent=indent, ensure_ascii=indent is not None, allow_nan=False
    )


def convert_to_plain(value: Any) -> Any:
    """Convert data to what JSON can express: dictionaries, lists, texts and finite numbers.

    Other numbers become None.
    """
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if isinstance(value, Array):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): convert_to_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [convert_to_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def flatten(nested: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Flatten nested items: the key of an inner item follows its outer key and "_".

    A `ci95` pair becomes `low` and `high`, which are None if there is no interval. Lists become
    text.
    """
    row: dict[str, Any] = {}
    for key, value in nested.items():
        flat_key = f"{prefix}{key}"
        if isinstance(value, Mapping):
            row |= flatten(value, f"{flat_key}_")
        elif key == "ci95":
            lower_end, upper_end = value or (None, None)
            row[f"{prefix}low"] = lower_end
            row[f"{prefix}high"] = upper_end
        elif isinstance(value, list | tuple):
            row[flat_key] = "; ".join(map(str, value))
        else:
            row[flat_key] = value
    return row

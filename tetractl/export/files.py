"""Table files that grow by the rows of one log after another: CSV, and Parquet by pyarrow."""

import csv
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

from tetractl.core.errors import LogError, UsageError
from tetractl.core.text import cell
from tetractl.export.tables import Columns

PART = ".part"


class TableFile(Protocol):
    """A file of one table."""

    def add(self, columns: Columns) -> None:
        """Add rows; the columns are those of the first call."""
        ...

    def close(self) -> None:
        """Finish the file."""
        ...


class CsvFile:
    """A table as CSV after RFC 4180: UTF-8, a header, empty cells for what is not known."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("w", encoding="utf-8", newline="")
        self._writer = csv.writer(self._file, lineterminator="\n")
        self._headed = False

    def add(self, columns: Columns) -> None:
        """Add rows."""
        if not self._headed:
            self._writer.writerow(columns)
            self._headed = True
        self._writer.writerows(zip(*map(_cells, columns.values()), strict=True))

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _cells(values: list[Any]) -> list[Any]:
    """Return cells as R, MATLAB and spreadsheets read them: truth values as true and false.

    A text that a spreadsheet would compute gets an apostrophe in front.
    """
    names = {True: "true", False: "false"}
    if any(isinstance(value, bool) for value in values):
        return [names.get(value, value) for value in values]
    if any(isinstance(value, str) for value in values):
        return [cell(v) if isinstance(v, str) else v for v in values]
    return values


class ParquetFile:
    """A table as Parquet, one row group a log."""

    def __init__(self, path: Path) -> None:
        self._path, self._writer = path, None

    def add(self, columns: Columns) -> None:
        """Add rows; the first call decides the type of each column."""
        import pyarrow
        import pyarrow.parquet

        if self._writer is None:
            table = pyarrow.table({name: _typed(name, v) for name, v in columns.items()})
            self._writer = pyarrow.parquet.ParquetWriter(self._path, table.schema)
        else:
            table = pyarrow.table(columns, schema=self._writer.schema)
        self._writer.write_table(table)

    def close(self) -> None:
        """Write the file's footer."""
        if self._writer is not None:
            self._writer.close()


_TEXT = ("log", "robot", "level", "text", "stopped", "outcome", "origin", "reason")


def _typed(name: str, values: list[Any]) -> Any:
    """Return a pyarrow array; a column of the first log that knows no value is text or a number."""
    import pyarrow

    if any(value is not None for value in values):
        return pyarrow.array(values)
    return pyarrow.array(values, pyarrow.string() if name in _TEXT else pyarrow.float64())


FORMATS = {"csv": CsvFile, "parquet": ParquetFile}


def check_format(name: str) -> None:
    """Raise UsageError for an unknown format, or one whose library is not installed."""
    if name not in FORMATS:
        raise UsageError(f"cannot write {name!r} tables", f"choose {' or '.join(FORMATS)}")
    if name == "parquet" and find_spec("pyarrow") is None:
        raise UsageError(
            "Parquet needs pyarrow, which is not installed",
            "pip install 'tetractl[parquet]', or choose csv",
        )


class Tables:
    """The files of several tables, each complete or absent: NAME.part until the block ends well."""

    def __init__(self, paths: Mapping[str, Path], format_name: str) -> None:
        self._paths = dict(paths)
        self._kind = FORMATS[format_name]
        self._files: dict[str, TableFile] = {}
        self._columns: dict[str, list[str]] = {}

    def __enter__(self) -> Self:
        try:
            for table, path in self._paths.items():
                path.parent.mkdir(parents=True, exist_ok=True)
                self._files[table] = self._kind(_part(path))
        except OSError as error:
            raise _refused(error) from error
        return self

    def add(self, log: str, trial: int, table: str, columns: Columns) -> None:
        """Add the rows of one log to a table.

        Raises UsageError where its columns are not those of the logs before.
        """
        rows = len(next(iter(columns.values())))
        columns = {"log": [log] * rows, "trial": [trial] * rows} | columns
        known = self._columns.setdefault(table, list(columns))
        if list(columns) != known:
            odd = sorted(set(columns) ^ set(known))
            raise UsageError(
                f"{log}: its {table} have other columns than those before: {', '.join(odd[:4])}",
                "export the logs of each experiment by themselves",
            )
        try:
            self._files[table].add(columns)
        except OSError as error:
            raise _refused(error) from error

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            for file in self._files.values():
                file.close()
            for path in self._paths.values():
                part = _part(path)
                if kind is None and part.exists():
                    part.replace(path)
                else:
                    part.unlink(missing_ok=True)
        except OSError as failure:
            raise _refused(failure) from failure


def _part(path: Path) -> Path:
    return path.with_name(path.name + PART)


def _refused(error: OSError) -> LogError:
    return LogError(f"{error.filename or 'table'}: cannot write the table: {error.strerror}")

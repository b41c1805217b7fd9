"""Writes tables as data: JSON, and CSV after RFC 4180."""

import io
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, is_dataclass
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import Any, TextIO

from tetractl.core.errors import LogError, UsageError, entry
from tetractl.core.table.table import Array, Table

PART = ".part"
_NUMBERS = {float, int, bool, type(None)}


def csv_text(table: Table) -> str:
    """Return a table as CSV."""
    text = io.StringIO()
    _write_csv(table, text, header=True)
    return text.getvalue()


def _write_csv(table: Table, stream: TextIO, header: bool) -> None:
    if header:
        stream.write(",".join(_text(column.key) for column in table.columns) + "\n")
    rows = zip(*_cells([column.listed for column in table.columns]), strict=True)
    stream.write("".join(f"{','.join(row)}\n" for row in rows))


def _cells(columns: list[Sequence[Any]]) -> Iterator[Sequence[str]]:
    """Yield columns of entries as R, MATLAB and spreadsheets read them: numbers with all digits,
    truth values as true and false, unknown values empty. Neighbouring columns of numbers are one.

    Text that a spreadsheet would evaluate gets an apostrophe in front.
    """
    from pydantic_core import to_json  # slow to import, and not needed by most commands

    for plain_values, group in groupby(columns, lambda one: set(map(type, one)) <= _NUMBERS):
        if not plain_values:
            yield from ([*map(_text, values)] for values in group)
            continue
        rows = [*zip(*group, strict=True)]
        text = to_json(rows, inf_nan_mode="constants").decode()[2:-2]  # 9 times as fast as repr
        for word, ours in (("null", ""), ("NaN", ""), ("Infinity", "inf")):
            text = text.replace(word, ours) if word[0] in text else text
        yield text.split("],[") if rows else []


@lru_cache(typed=True)  # columns repeat their words
def _text(value: Any) -> str:
    if not isinstance(value, str):
        return next(_cells([[value]]))[0] if type(value) in _NUMBERS else str(value)
    text = entry(value)
    return '"{}"'.format(text.replace('"', '""')) if re.search('[",\r\n]', text) else text


AddRows = Callable[[Table], None]


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Name the file in an error of writing it, such as of a full disk."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


@contextmanager
def _csv_file(path: Path) -> Iterator[AddRows]:
    """Write a table as CSV: UTF-8, a header, empty entries for unknown values."""
    file = path.open("w", encoding="utf-8", newline="")
    try:
        yield lambda table: _write_csv(table, file, header=not file.tell())
    finally:
        with _naming(path):
            file.close()


@contextmanager
def table_files(
    paths: Mapping[str, Path],
) -> Iterator[Callable[[str, Table, str], None]]:
    """Write the CSV files of several tables; yields the function that adds rows to one of them.

    It is called with the name of a file, the rows, and their source for messages; it raises
    UsageError if the columns differ from those of earlier rows. Each file is written as NAME.part,
    and renamed at the end of the `with` block unless there was an error.
    """
    parts = {name: path.with_name(path.name + PART) for name, path in paths.items()}
    keys: dict[str, list[str]] = {}
    files: dict[str, AddRows] = {}

    def add(name: str, table: Table, source: str) -> None:
        now = [column.key for column in table.columns]
        known = keys.setdefault(name, now)
        if now != known:
            odd = sorted(set(now) ^ set(known))
            raise UsageError(
                f"{source}: the columns of {name} differ from earlier ones: {', '.join(odd[:4])}",
                "export the logs of each experiment separately",
            )
        with _naming(parts[name]):
            files[name](table)

    try:
        try:
            with ExitStack() as stack:
                for name, part in parts.items():
                    part.parent.mkdir(parents=True, exist_ok=True)
                    files[name] = stack.enter_context(_csv_file(part))
                yield add
            for name, part in parts.items():
                if part.exists():
                    part.replace(paths[name])
        finally:
            for part in parts.values():
                part.unlink(missing_ok=True)
    except OSError as error:
        where = error.filename or "table"
        raise LogError(f"{where}: cannot write the table: {error.strerror}") from error


def json_text(value: Any, indent: int | None = 2) -> str:
    """Return JSON of plain data, dataclasses and arrays; null for a number that is not finite."""
    return json.dumps(plain(value), indent=indent, ensure_ascii=indent is not None, allow_nan=False)


def plain(value: Any) -> Any:
    """Convert data to dictionaries, lists, texts and finite numbers; other numbers become None."""
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if isinstance(value, Array):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def flat(items: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Flatten nested items: a `ci95` pair becomes `low` and `high`, lists become text."""
    found: dict[str, Any] = {}
    for key, value in items.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            found |= flat(value, f"{name}_")
        elif key == "ci95":
            low, high = value or (None, None)
            found |= {f"{prefix}low": low, f"{prefix}high": high}
        else:
            found[name] = "; ".join(map(str, value)) if isinstance(value, list | tuple) else value
    return found

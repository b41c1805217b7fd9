"""Read CSV files in the many forms in which spreadsheets and other programs write them.

The encoding is UTF-8, UTF-16 with a byte order mark, or Windows' Latin-1. Entries are separated by
commas, semicolons, tabs or blanks. If commas do not separate entries, a decimal comma is also read.
These are left out: spaces around entries, lines of comments (#), titles above the header, and a
line such as `sep=;`. Characters are converted to Unicode's form NFKC, so that names that look the
same are the same.
"""

import codecs
import csv
import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice, zip_longest
from pathlib import Path
from typing import TextIO

from tetractl.core.errors import UsageError, printable

CSV_BYTES_MAX = 1 << 28
"""Maximum size of a CSV file [bytes]."""
CSV_ROWS_MAX = 2_000_000
"""Maximum number of rows of a CSV file."""
CSV_LINE_MAX = 1 << 16
"""Maximum length of a line of a CSV file [characters]."""
CHUNK_BYTES = 1 << 20
"""Number of bytes that are decoded at a time, to find the encoding."""
TITLES_MAX = 10
"""Maximum number of lines of titles above a header."""
UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
SEPARATORS = (",", ";", "\t", "|")
"""Characters that may separate the entries of a line."""
ARCHIVES = {b"\x1f\x8b": "gzip", b"PK": "zip, or a spreadsheet", b"(\xb5": "zstd", b"BZ": "bzip2"}
"""The formats of compressed files, by their first bytes."""
BLANK_SEPARATOR = " "
"""The separator of entries between which there are only blanks."""
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?|[+-]?\d+,")
DECIMAL_COMMA_HINT = "a decimal comma needs semicolons or tabs between entries"
"""Hint for numbers with a decimal comma."""
_SEPARATOR_LINE = re.compile(r"sep=(.)$", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class CsvRow:
    """A row of a CSV file.

    Attributes:
        line: Line number, from 1.
        cells: The entries, by column name. Missing entries are "".
    """

    line: int
    cells: dict[str, str]


def read_csv(path: Path) -> Iterator[CsvRow]:
    """Yield the rows of a CSV file. Empty lines are left out.

    A file without lines, or with comments only, yields nothing.

    Raises:
        UsageError: If the file does not exist, is compressed or not CSV, begins with numbers
            instead of a header, has a column name twice, repeats its header, has a row with too
            many entries, or is larger than the limits above.
    """
    try:
        yield from _parse_rows(path, csv_lines(path))
    except csv.Error as error:
        raise UsageError(
            f"{path}: this is not a CSV file: {error}", "save the file as UTF-8"
        ) from None


def csv_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the non-empty lines of a CSV file with their numbers, which start at 1.

    Raises:
        UsageError: In the same cases as `read_csv`.
    """
    if not path.is_file():
        problem = "is not a regular file" if path.exists() else "no such file"
        raise UsageError(f"{path}: {problem}")
    if path.stat().st_size > CSV_BYTES_MAX:
        raise _create_size_error(path)
    _refuse_archive(path)
    try:
        with path.open(newline="", encoding=_detect_encoding(path)) as stream:
            yield from _read_lines(path, stream)
    except UnicodeError as error:
        raise UsageError(
            f"{path}: this is not a CSV file: {error}", "save the file as UTF-8"
        ) from None


def read_column_names(path: Path) -> tuple[str, ...]:
    """Return the column names of a CSV file. Empty if the file has no row below the header.

    Raises:
        UsageError: In the same cases as `read_csv`.
    """
    first_row = next(read_csv(path), None)
    return () if first_row is None else tuple(first_row.cells)


def _create_size_error(path: Path) -> UsageError:
    limits = f"{CSV_BYTES_MAX >> 20} MiB, {CSV_ROWS_MAX} rows or {CSV_LINE_MAX} characters in a row"
    return UsageError(
        f"{path}: the file has more than {limits}", "split the file into several files"
    )


def _refuse_archive(path: Path) -> None:
    """Raise UsageError if a file is compressed, as its first two bytes show."""
    with path.open("rb") as file:
        archive_format = ARCHIVES.get(file.read(2))
    if archive_format is not None:
        raise UsageError(
            f"{path}: the file is compressed ({archive_format}), so it is not a CSV file",
            "unpack the file, or export it as CSV",
        )


def _detect_encoding(path: Path) -> str:
    """Detect the encoding of a text file: "utf-16", "utf-8-sig" or "cp1252".

    A byte order mark at the start indicates UTF-16. A file that is neither UTF-16 nor valid UTF-8
    counts as "cp1252".
    """
    decoder = codecs.getincrementaldecoder("utf-8")()
    with path.open("rb") as file:
        if file.read(2) in UTF_16:
            return "utf-16"
        file.seek(0)
        try:
            while chunk := file.read(CHUNK_BYTES):
                decoder.decode(chunk)
            decoder.decode(b"", final=True)
        except UnicodeDecodeError:
            return "cp1252"
    return "utf-8-sig"


def _read_lines(path: Path, stream: TextIO) -> Iterator[tuple[int, str]]:
    """Yield the non-empty lines of a file, with their numbers, which start at 1.

    Raises:
        UsageError: If the file or a line is too large, or has a null character.
    """
    for number, line in enumerate(iter(partial(stream.readline, CSV_LINE_MAX), ""), 1):
        if number > CSV_ROWS_MAX + 1 or len(line) == CSV_LINE_MAX:
            raise _create_size_error(path)
        if "\0" in line:
            raise UsageError(
                f"{path}, line {number}: this is not a CSV file, because it has a null character"
            )
        if line.strip():
            yield number, unicodedata.normalize("NFKC", line)


def _parse_rows(path: Path, lines: Iterator[tuple[int, str]]) -> Iterator[CsvRow]:
    """Parse the lines of a CSV file, and yield the rows below the header.

    The header may be a comment if numbers follow, as NumPy writes it.
    """
    comments: list[str] = []
    stated_separator = ""
    for header_line in lines:
        line_text = header_line[1].strip()
        match = _SEPARATOR_LINE.match(line_text)
        if match:
            stated_separator = match[1]
        elif line_text.startswith("#"):
            comments.append(line_text.lstrip("# "))
        else:
            break
    else:
        return
    header_line, lines_below = _skip_titles(header_line, lines)
    header_text = header_line[1].rstrip().lstrip(" ")  # a tab before it ends a name that is empty
    separator = stated_separator or _find_separator(
        header_text, lines_below[0][1] if lines_below else ""
    )
    header = split_entries(header_text, separator)
    if comments and any(map(is_number, header)):
        lines_below.insert(0, header_line)
        header = split_entries(comments[-1], separator)
    _check_header(path, header)
    for number, line in chain(lines_below, lines):
        entries = split_entries(line, separator)
        if entries == header:
            raise UsageError(
                f"{path}, line {number}: the header occurs a second time",
                "if the file holds two tables, put them under one header, and number them "
                "in a column named trial",
            )
        if any(entries):
            yield CsvRow(number, _assign_cells(path, number, header, entries))


def _skip_titles(
    first_line: tuple[int, str], lines: Iterator[tuple[int, str]]
) -> tuple[tuple[int, str], list[tuple[int, str]]]:
    """Skip titles above the header, and return the header with the lines read below it.

    A line with one entry, such as Imaris writes above a header, is a title if several names follow.
    """
    if len(_split_into_most_entries(first_line[1])) > 1:
        return first_line, list(islice(lines, 1))
    lines_below: list[tuple[int, str]] = []
    for line in islice(lines, TITLES_MAX):
        entries = _split_into_most_entries(line[1])
        if len(entries) > 1 and not any(map(is_number, entries)):
            return line, list(islice(lines, 1))
        lines_below.append(line)
        if len(entries) > 1:
            break
    return first_line, lines_below


def _split_into_most_entries(line: str) -> list[str]:
    """Split a line by the separator that gives the most entries, the first one if several do."""
    stripped_line = line.rstrip().lstrip(" ")
    return max((split_entries(stripped_line, separator) for separator in SEPARATORS), key=len)


def _find_separator(header: str, row: str) -> str:
    """Find the separator of a table's entries: the one that splits the header into most entries.

    If no separator splits the header into two entries, but blanks split the header and the row
    below into equally many, the separator is blanks.
    """
    best_separator = max(SEPARATORS, key=lambda separator: len(split_entries(header, separator)))
    word_count = len(header.split())
    entry_count = len(split_entries(header, best_separator))
    if entry_count == 1 and 1 < word_count == len(row.split()):
        return BLANK_SEPARATOR
    return best_separator


def split_entries(line: str, separator: str) -> list[str]:
    """Split a line into its entries, without blanks around them.

    If the separator is neither a comma nor blanks, a decimal comma becomes a point. A quoted entry
    with line breaks ends at the end of the line.
    """
    if separator == BLANK_SEPARATOR:
        return line.split()
    # line by line, since a quoted entry with line breaks may have any length
    entries = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    stripped = [entry.strip() for entry in entries]
    if separator == ",":
        return stripped
    return [
        entry_text.replace(",", ".") if has_decimal_comma(entry_text) else entry_text
        for entry_text in stripped
    ]


def has_decimal_comma(entry: str) -> bool:
    """Check whether an entry is a number with a decimal comma."""
    return _DECIMAL_COMMA.fullmatch(entry) is not None


def is_number(entry: str) -> bool:
    """Check whether Python's `float` can read an entry of a table.

    This holds for "3" and "1.5", and also for "nan", "inf" and "1_000". It does not hold for "1,5"
    with a decimal comma.
    """
    try:
        float(entry)
    except ValueError:
        return False
    return True


def _check_header(path: Path, header: list[str]) -> None:
    """Raise UsageError if a header consists of numbers, or contains a name twice."""
    if any(map(is_number, header)):
        raise UsageError(
            f"{path}: the file has no header: its first line has numbers",
            "write the names of the columns, such as time_s, into a line above the numbers",
        )
    for name in header:
        if name and header.count(name) > 1:
            raise UsageError(f"{path}: two columns have the same name, {printable(name)}")


def _assign_cells(path: Path, line: int, header: list[str], entries: list[str]) -> dict[str, str]:
    """Assign the entries of a row to the columns of a table. Missing entries are "".

    Columns without a name are left out.

    Raises:
        UsageError: If there are more entries than columns.
    """
    if any(entries[len(header) :]):
        raise UsageError(
            f"{path}, line {line}: this line has {len(entries)} entries, but the header has "
            f"{len(header)}",
            DECIMAL_COMMA_HINT,
        )
    return {name: entry for name, entry in zip_longest(header, entries, fillvalue="") if name}

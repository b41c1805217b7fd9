"""A table: columns of values, each with a name, a unit and a format for readers."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Self, runtime_checkable

UNKNOWN_TEXT = "-"
"""The text for an unknown value."""
LISTED_TEXTS_MAX = 4
"""Maximum number of texts in one line."""


def create_decimal_format(decimals: int) -> Callable[[float], str]:
    """Create a format of numbers with a fixed number of decimals. Unknown numbers become "-"."""

    def show(value: float | None) -> str:
        return (
            UNKNOWN_TEXT if value is None or not math.isfinite(value) else f"{value:.{decimals}f}"
        )

    return show


def create_length_format(scale: float, decimals_max: int = 9) -> Callable[[float], str]:
    """Create a format with three significant digits for lengths of about `scale`.

    The format has at least one decimal below 1000, and at most `decimals_max` decimals.
    """
    scale = abs(scale)
    exponent = math.floor(math.log10(scale)) if math.isfinite(scale) and scale > 0 else 1
    decimals_min = 1 if exponent < 3 else 0
    return create_decimal_format(min(max(2 - exponent, decimals_min), decimals_max))


def format_digits(value: float) -> str:
    """Format a number with three significant digits, and at most nine decimals.

    A number that is not positive has no decimals. The text is "-" if the number is not finite.
    """
    if value <= 0 or not math.isfinite(value):
        return create_decimal_format(0)(value)
    decimals = 2 - math.floor(math.log10(value))
    return create_decimal_format(min(max(decimals, 0), 9))(value)


def pluralize(noun: str, count: int) -> str:
    """Return a noun in the form that follows a count: with an "s", unless the count is 1."""
    return noun if count == 1 else f"{noun}s"


def join_listed(entries: Sequence[str], separator: str = ", ") -> str:
    """Join at most LISTED_TEXTS_MAX texts into one line, and add how many more there are."""
    listed = separator.join(entries[:LISTED_TEXTS_MAX])
    unlisted = len(entries) - LISTED_TEXTS_MAX
    return f"{listed} and {unlisted} more" if unlisted > 0 else listed


def format_p_value(probability: float) -> str:
    """Format a p-value with two digits, or as "< 0.001" if it is smaller than that. "-" for NaN."""
    if not math.isfinite(probability):
        return UNKNOWN_TEXT
    return f"{probability:.2g}" if probability >= 0.001 else "< 0.001"


def format_value(value: Any) -> str:
    """Return a value as text. None and NaN become "-"."""
    return UNKNOWN_TEXT if value is None or value != value else str(value)


@runtime_checkable
class Array(Protocol):
    """An array or a number of NumPy, which is slow to import."""

    def tolist(self) -> Any:
        """Return the values of the array as Python objects."""
        ...


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table: the values of one quantity. None or NaN means unknown.

    Attributes:
        name: Name of the quantity. In a data file, the column is called `name_unit`.
        values: The values.
        unit: Unit of the values. Empty if they have none.
        format: Function that formats a value for people, below the heading "name [unit]".
        words: Whether the column is left-aligned and may be wrapped. All others are numbers.
    """

    name: str
    values: Any  # a sequence or an array
    unit: str = ""
    format: Callable[[Any], str] = format_value
    words: bool = False

    @property
    def heading(self) -> str:
        """The heading of the column in a printed table: its name, and its unit in brackets."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def key(self) -> str:
        """The column's name in a data file, which ends in the unit, such as `speed_mm_s`.

        It is only the name if the column has no unit.
        """
        return f"{self.name}_{self.unit.replace('/', '_')}" if self.unit else self.name

    @property
    def texts(self) -> list[str]:
        """The text of each value in the column, formatted by `format`."""
        return [self.format(value) for value in self.values]

    @property
    def listed(self) -> Sequence[Any]:
        """The values of the column as Python objects."""
        # a check with `isinstance(values, Array)` would take as long as 100 values
        values = self.values
        return values if isinstance(values, list | tuple) else values.tolist()


@dataclass(frozen=True, slots=True)
class Table:
    """A table of columns of equal length.

    Attributes:
        title: Title above the table.
        columns: The columns, from left to right.
        note: Text below the table. Empty if there is none.
    """

    title: str
    columns: tuple[Column, ...]
    note: str = ""

    @classmethod
    def of_texts(cls, title: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> Self:
        """Create a table from rows of texts.

        A column that is empty in all rows is left out, unless it is the first. An entry is empty if
        it is "" or "-".

        Args:
            title: Title of the table.
            header: Names of the columns.
            rows: The entries.
        """
        by_column = list(zip(*rows, strict=True)) or [()] * len(header)
        columns = [
            Column(name, entries, words=True)
            for name, entries in zip(header, by_column, strict=True)
        ]
        filled = [column for column in columns[1:] if set(column.texts) - {"", UNKNOWN_TEXT}]
        return cls(title, (columns[0], *filled))

    @classmethod
    def of_records(cls, title: str, records: Sequence[Mapping[str, Any]]) -> Self:
        """Create a table from records, with one row for each.

        Columns are in the order in which their keys first occur. If a record lacks a key, its value
        is None.
        """
        keys = dict.fromkeys(key for record in records for key in record)
        columns = [Column(key, [record.get(key) for record in records]) for key in keys]
        return cls(title, tuple(columns))

    @property
    def header(self) -> list[str]:
        """The headings of the table's columns, as "name [unit]"."""
        return [column.heading for column in self.columns]

    @property
    def rows(self) -> Iterator[tuple[str, ...]]:
        """The rows of the table, as formatted texts, without the header."""
        return zip(*(column.texts for column in self.columns), strict=True)

    @property
    def words(self) -> bool:
        """Whether any column other than the first contains words instead of numbers.

        False for one column.
        """
        return any(column.words for column in self.columns[1:])

    def __len__(self) -> int:
        return len(self.columns[0].values) if self.columns else 0

    def with_first(self, **constants: Any) -> "Table":
        """Return a copy of the table with further columns in front, each with a constant value.

        Args:
            **constants: The value of each further column, by name.
        """
        constant_columns = (Column(name, [value] * len(self)) for name, value in constants.items())
        return Table(self.title, (*constant_columns, *self.columns), self.note)

    def as_dict(self) -> dict[str, Any]:
        """Return {column key: values}, from which a data frame can be made."""
        return {column.key: column.values for column in self.columns}

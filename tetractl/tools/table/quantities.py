"""Find the columns of a table by the quantity that they contain, such as time or x.

Names of columns end in units, as in `time_ms`, `direction (deg)` or `x [um]`. Numbers are converted
to the unit that the caller needs.
"""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tetractl.core.errors import UsageError, printable
from tetractl.core.poses import Floats, describe_excess_angle
from tetractl.tools.table.csv_rows import DECIMAL_COMMA_HINT, CsvRow, has_decimal_comma

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
"""Units of times, each with its size [s]."""
RADIANS = {"rad": 1.0, "deg": math.pi / 180}
"""Units of angles, each with its size [rad]."""
RADIANS_S = {"rad_s": 1.0, "deg_s": math.pi / 180}
"""Units of turning rates, each with its size [rad/s]."""
TIME_NAMES = ("time", "t", "timestamp")
"""Names of columns of times, before their units."""
METRES = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0}
"""Units of lengths, each with its size [m]."""
METRES_S = {f"{unit}_s": metres for unit, metres in METRES.items()}
"""Units of speeds, each with its size [m/s]."""
UNIT_SPELLINGS = {
    "sec": "s",
    "seconds": "s",
    "second": "s",
    "msec": "ms",
    "milliseconds": "ms",
    "millisecond": "ms",
    "µs": "us",
    "μs": "us",
    "usec": "us",
    "microseconds": "us",
    "microsecond": "us",
    "nsec": "ns",
    "nanoseconds": "ns",
    "nanosecond": "ns",
    "mins": "min",
    "minute": "min",
    "minutes": "min",
    "radians": "rad",
    "degrees": "deg",
    "degree": "deg",
    "°": "deg",
    "µm": "um",
    "μm": "um",
    "micron": "um",
    "microns": "um",
    "micrometer": "um",
    "nanometer": "nm",
    "millimeter": "mm",
    "centimeter": "cm",
    "meter": "m",
}
"""Other spellings of units."""
_UNITS = {unit: unit for unit in (*SECONDS, *RADIANS, *RADIANS_S, *METRES, *METRES_S)}
_UNITS |= UNIT_SPELLINGS
_BRACKETS = re.compile(r"(.*?)_*[\[(](.*)[\])]")
_UNKNOWN_ENTRIES = {"", "nan", "na", "n/a", "#n/a", "null", "none", "-"}
"""Entries that state no number."""
NOT_MEASURED_HINT = "if nothing was measured, leave the entry empty"
PLAIN_NUMBERS_HINT = "write numbers like 1234.5, without units, colons or thousands separators"
"""Hint for an entry that begins with a digit but is not a number.

`NOT_MEASURED_HINT` is for words.
"""
_TRUTH_VALUES = {
    "true": True,
    "1": True,
    "yes": True,
    "": True,
    "false": False,
    "0": False,
    "no": False,
}
NUMBER_MAX = 1e9
"""Maximum absolute value of a number that is not a time. Of times, only differences matter."""
WRAP_MIN_DEG = 300.0
"""Minimum jump of a direction that has gone from 360 to 0 degrees [deg].

The maximum jump is a whole turn.
"""
TIME_MAX = 1e19
"""Maximum absolute value of a time in any unit: that of nanoseconds since 1970 is 1.8e18."""


@dataclass(frozen=True, slots=True)
class NumberColumn:
    """A column of numbers in a table, with the factor that converts its unit.

    Attributes:
        key: Name of the column in the table.
        factor: Factor from the table's unit to the unit that is needed.
        largest: Maximum number that is accepted.
    """

    key: str
    factor: float = 1.0
    number_max: float = NUMBER_MAX

    def number(self, path: Path, row: CsvRow) -> float:
        """Read the number of this column in a row, converted to the needed unit.

        Raises:
            UsageError: If the entry is missing, is not a number, or is too large.
        """
        number = self.read_optional(path, row)
        if math.isnan(number):
            raise UsageError(
                f"{path}, line {row.line}: {printable(self.key)}: this is not a number"
            )
        return number

    def read_optional(self, path: Path, row: CsvRow) -> float:
        """Read the number of this column in a row, converted to the needed unit.

        The result is NaN if the entry is missing or marked as unknown.

        Raises:
            UsageError: If the entry is not a number, or is too large.
        """
        entry = row.cells[self.key]
        if entry.lower() in _UNKNOWN_ENTRIES:
            return math.nan
        try:
            number = float(entry)
        except ValueError:
            number = math.inf
        if not abs(number) <= self.number_max:
            problem = f"{entry[:60]!r} is not a number of at most {self.number_max:g}"
            hint = PLAIN_NUMBERS_HINT if entry[:1].isdigit() else NOT_MEASURED_HINT
            if has_decimal_comma(entry):
                hint = DECIMAL_COMMA_HINT
            raise UsageError(f"{path}, line {row.line}: {printable(self.key)}: {problem}", hint)
        return number * self.factor


def split_header(header: str) -> tuple[str, str]:
    """Split the header of a column into its name in lower case and its unit.

    The unit is "" if there is none.
    """
    lower_header = header.strip().lower()
    normalised = re.sub(r"[ _/]+", "_", lower_header).replace("_per_", "_")
    match = _BRACKETS.fullmatch(normalised)
    if match:
        unit_parts = match[2].split("_")
        return match[1], "_".join(_UNITS.get(unit_part, unit_part) for unit_part in unit_parts)
    for unit in sorted(_UNITS, key=len, reverse=True):
        if normalised.endswith(f"_{unit}"):
            return normalised.removesuffix(f"_{unit}"), _UNITS[unit]
    return normalised, ""


def find_factor(unit: str, units: Mapping[str, float]) -> float | None:
    """Return the factor of a unit, in any spelling. None if `units` does not contain the unit."""
    normalised = unit.strip().lower()
    return units.get(UNIT_SPELLINGS.get(normalised, normalised))


def find_column(
    path: Path, headers: Collection[str], names: Collection[str], units: Mapping[str, float]
) -> NumberColumn | None:
    """Find the column of a quantity, by its possible names and units.

    Args:
        path: File of the table, for error messages.
        headers: The names of the table's columns.
        names: The possible names of the quantity, without units.
        units: The possible units, with the factor from each unit to the needed unit.

    Returns:
        The column. None if no column has such a name.

    Raises:
        UsageError: If all columns with such a name have other units, or none.
    """
    quantities = {header: split_header(header) for header in headers}
    matching = {header: unit for header, (name, unit) in quantities.items() if name in names}
    for header, unit in matching.items():
        if unit in units:
            number_max = TIME_MAX if units is SECONDS else NUMBER_MAX
            return NumberColumn(header, units[unit], number_max)
    for header, unit in matching.items():
        problem = f"is in {printable(unit)}" if unit else "states no unit"
        named = " or ".join(f"{quantities[header][0]}_{accepted}" for accepted in list(units)[:2])
        raise UsageError(f"{path}: column {printable(header)} {problem}", f"name it {named}")
    return None


def find_time(path: Path, headers: Collection[str]) -> NumberColumn | None:
    """Return the column of times, whose numbers are converted to seconds. None if there is none.

    Raises:
        UsageError: If the column states another unit, or none.
    """
    return find_column(path, headers, TIME_NAMES, SECONDS)


def refuse_degrees(path: Path, column: NumberColumn, lines: Sequence[int], angles: Floats) -> None:
    """Refuse directions that are probably in degrees.

    Directions beyond a whole turn are checked by their steps, because a field that keeps turning
    may count its turns. Degrees step by more than 2 pi or, for a rotating field, by a turn minus a
    step. A single direction only reveals its size.

    Args:
        path: The table.
        column: The column of the directions.
        lines: Line of each direction.
        angles: The directions [rad], shape (R,).

    Raises:
        UsageError: If they are probably in degrees.
    """
    beyond_turn = np.flatnonzero(np.abs(angles) > 2 * math.pi)
    if column.factor != 1 or not len(beyond_turn):
        return
    steps = np.abs(np.diff(angles))
    steps = steps[steps > 0]
    jumps = steps[steps > 2 * math.pi]
    may_wrap = len(jumps) > 0 and jumps.min() > WRAP_MIN_DEG and jumps.max() <= 360
    if len(steps) and np.median(steps) <= 2 * math.pi and not may_wrap:
        return
    first_beyond = int(beyond_turn[0])
    problem = describe_excess_angle(float(angles[first_beyond]))
    assert problem is not None
    message, hint = problem
    quantity = split_header(column.key)[0]
    position = f"{path}, line {lines[first_beyond]}: {printable(column.key)}"
    raise UsageError(
        f"{position}: {angles[first_beyond]:g} {message}",
        f"{hint}, or rename the column to {quantity}_deg",
    )


def create_order_error(path: Path, row: CsvRow, further_hint: str = "") -> UsageError:
    """Create the error for a row whose time is earlier than in the rows before.

    Args:
        path: The table.
        row: The row.
        further_hint: What else may help, besides sorting the rows. Empty if nothing.
    """
    return UsageError(
        f"{path}, line {row.line}: the time is earlier than in the line before",
        f"sort the rows by time{further_hint}",
    )


def read_boolean(path: Path, row: CsvRow, column: str) -> bool:
    """Read a truth value in a row of a table.

    The result is True if the table has no such column, or if the entry is empty.

    Args:
        path: File of the table, for error messages.
        row: The row.
        column: Name of the column.

    Raises:
        UsageError: If the entry is neither true nor false.
    """
    entry = row.cells.get(column, "")
    try:
        return _TRUTH_VALUES[entry.lower()]
    except KeyError:
        problem = f"{printable(entry[:60])} is neither true nor false"
        raise UsageError(f"{path}, line {row.line}: {printable(column)}: {problem}") from None

"""Reads columns of numbers from CSV files."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tetractl.core.errors import UsageError, printable
from tetractl.core.poses import Floats
from tetractl.tools.table.csv_rows import columns_of, read_csv
from tetractl.tools.table.quantities import find_time


def read_times(path: Path) -> Floats:
    """Return the column of times (R,) [s] of a CSV file with at least one row; UsageError if it has
    none."""
    headers = columns_of(path)
    column = find_time(path, headers)
    if column is None:
        raise no_column(path, "time_s", headers)
    return np.array([column.number(path, row) for row in read_csv(path)])


def no_column(path: Path, name: str, headers: Sequence[str]) -> UsageError:
    """Return the error that a table has no column of a name."""
    if not headers:
        return UsageError(f"{path}: has no rows")
    has = printable(", ".join(headers[:8]))
    return UsageError(f"{path}: has no column {name}: its columns are {has}")

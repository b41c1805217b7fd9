"""Reads columns of numbers from CSV files."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats
from tetractl.core.table.table_files import read_csv


def read_numbers(path: Path, names: Sequence[str], defaults: Mapping[str, float]) -> Floats:
    """Return the columns `names` (R, N) of a CSV file with at least one row. UsageError if one is
    missing, or has a text or an infinite number; an empty entry may have a default.
    """
    table = []
    for line, row in enumerate(read_csv(path), 2):
        for name in names:
            with suppress(KeyError, ValueError):
                value = float(row.get(name) or defaults[name])
                if math.isfinite(value):
                    table.append(value)
                    continue
            raise UsageError(f"{path}, line {line}: has no finite number in column {name}")
    if not table:
        raise UsageError(f"{path}: has no rows")
    return np.array(table).reshape(-1, len(names))

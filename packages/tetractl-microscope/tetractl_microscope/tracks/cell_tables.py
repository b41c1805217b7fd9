"""Creates tables of the measured cells from the record that `tetractl track --json` prints."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tetractl.statistics.estimate import (
    VALUES_MIN,
    Distribution,
    Interval,
    known_distribution,
    t_quantile,
)
from tetractl.tools.table.table import UNKNOWN_TEXT, Column, Table, create_decimal_format

Record = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity that is measured for each cell, and how tables show it.

    Attributes:
        name: Name of the quantity in data files.
        unit: Unit of the quantity. Empty if it has none.
        heading: Its heading in printed tables. Empty if it is only in data files.
        decimals: Number of decimals in printed tables.
        averaged: Whether the mean over the cells is printed.
        interval: Whether the quantity has an interval. Its entry in the record then has the form
            {"value": ..., "ci95": [low, high]}.
    """

    name: str
    unit: str = ""
    heading: str = ""
    decimals: int = 0
    averaged: bool = True
    interval: bool = False

    @property
    def key(self) -> str:
        """The key of the quantity in JSON: its name and its unit, such as "speed_um_s"."""
        return Column(self.name, (), self.unit).key.lower()


QUANTITIES = (
    Quantity("since", "s", "from", 1, averaged=False),
    Quantity("duration", "s", "for", 1, averaged=False),
    Quantity("pictures", averaged=False),
    Quantity("speed", "um/s", "speed", interval=True),
    Quantity("speed_sd", "um/s"),
    Quantity("vsl", "um/s", "VSL"),
    Quantity("path", "um", averaged=False),
    Quantity("sway", "rad", "sway", 2),
    Quantity("helix", "Hz", "helix", 1),
    Quantity("helix", "um"),
    Quantity("a", "rad/s", "a", 2, interval=True),
    Quantity("bias", "rad", "bias", 2, interval=True),
    Quantity("magnetised", "", "magnet", averaged=False),
)
"""The quantities that are measured for each cell, in the order of the columns."""
RESPONSE_KEYS = "a_rad_s", "bias_rad"
"""Keys of the quantities that are averaged only over cells that respond to the field."""


def create_cell_tables(record: Record) -> list[Table]:
    """Create the printed tables of cells: one row for each cell, and the mean of each quantity.

    Columns without any value are left out, and so are the means of fewer than two cells.
    """
    cells = record["cells"]
    columns = [Column("cell", [cell["cell"] for cell in cells])]
    for quantity in QUANTITIES:
        cell_texts = [format_entry(cell.get(quantity.key), quantity.decimals) for cell in cells]
        if quantity.heading and not {UNKNOWN_TEXT}.issuperset(cell_texts):
            columns.append(Column(quantity.heading, cell_texts, quantity.unit))
    note = "\n".join(record["notes"])
    means = create_mean_tables(cells)
    return [Table("Cells, with 95 % intervals", tuple(columns), note), *means]


def format_entry(entry: Any, decimals: int) -> str:
    """Format a cell's value of one quantity, with the 95 % interval in brackets if it has one.

    True and False become "yes" and "no".
    """
    if isinstance(entry, bool):
        return "yes" if entry else "no"
    if isinstance(entry, Mapping):
        low, high = (create_decimal_format(decimals)(bound) for bound in entry["ci95"])
        return f"{create_decimal_format(decimals)(entry['value'])} [{low}, {high}]"
    return create_decimal_format(decimals)(entry)


def extract_value(entry: Any) -> float | None:
    """Extract a cell's value of one quantity from an entry with or without an interval.

    The result is None if the value is unknown.
    """
    return entry["value"] if isinstance(entry, Mapping) else entry


def find_known_values(cells: Sequence[Record], key: str) -> tuple[list[Record], list[float]]:
    """Find the cells for which a quantity is known, and the values of this quantity.

    For a and bias, only cells that respond to the field count.

    Args:
        cells: The records of the cells.
        key: Key of the quantity in JSON.

    Returns:
        The records of these cells, and their values.
    """
    responding = [cell for cell in cells if key not in RESPONSE_KEYS or cell.get("magnetised")]
    with_values = [(cell, extract_value(cell.get(key))) for cell in responding]
    known_pairs = [(cell, value) for cell, value in with_values if value is not None]
    return [cell for cell, _ in known_pairs], [value for _, value in known_pairs]


def compute_cell_mean(cells: Sequence[Record], values: Sequence[float]) -> Distribution:
    """Compute the mean of cells' values, weighted by the time for which each cell was seen.

    A cell that was tracked under several numbers in turn occurs several times in `cells`.
    Therefore, n is the maximum number of cells that were seen at once, and the interval is that of
    Student's t for this n. With n < 3 there is no interval, and with n < 2 the standard deviation
    is NaN. Median, range and tail are always unknown.

    Args:
        cells: The records of one or more cells.
        values: The value of each cell.
    """
    durations_s = np.array([cell["duration_s"] for cell in cells])
    since_s = np.array([cell["since_s"] for cell in cells])
    middle_s = since_s + durations_s / 2
    # the number of cells is largest just after a cell appears
    after_start_s = since_s[:, None] + 1e-6
    is_seen = np.abs(after_start_s - middle_s) < durations_s / 2
    n_cells = int(is_seen.sum(axis=1).max())
    mean = float(np.average(values, weights=durations_s))
    if n_cells < 2:
        return known_distribution(n_cells, mean, math.nan, Interval.none("one value has no spread"))
    squared_deviations = np.square(np.array(values) - mean)
    std = math.sqrt(
        float(np.average(squared_deviations, weights=durations_s)) * n_cells / (n_cells - 1)
    )
    half_width = t_quantile(n_cells - 1) * std / math.sqrt(n_cells)
    no_interval = Interval.none(f"an interval needs {VALUES_MIN} cells")
    interval = (
        no_interval if n_cells < VALUES_MIN else Interval(mean - half_width, mean + half_width, "t")
    )
    return known_distribution(n_cells, mean, std, interval)


def create_mean_tables(cells: list[Record]) -> list[Table]:
    """Create the table of each quantity's mean over the cells, with its 95 % interval.

    The result is an empty list for fewer than two cells, or if no cell has a value. Quantities
    without any value have no row.
    """
    rows = []
    for quantity in QUANTITIES if len(cells) > 1 else ():
        known_cells, values = find_known_values(cells, quantity.key)
        if quantity.averaged and quantity.heading and values:
            mean = compute_cell_mean(known_cells, values)
            format_number = create_decimal_format(quantity.decimals)
            name = quantity.heading
            if quantity.unit:
                name += f" [{quantity.unit}]"
            if quantity.key in RESPONSE_KEYS:
                name += " of those that respond"
            std_text = format_number(mean.std)
            interval_text = mean.ci95.text(format_number)
            rows.append((name, str(mean.n), format_number(mean.mean), interval_text, std_text))
    header = ("mean over cells", "n", "mean", "95 % interval", "standard deviation")
    columns = zip(header, zip(*rows, strict=True), strict=True) if rows else ()
    table = Table("Means over cells", tuple(Column(name, values) for name, values in columns))
    return [table] if rows else []


def create_data_table(record: Record) -> Table:
    """Create the table for data files: one row for each cell, and two columns for each interval.

    The two columns are the lower and the upper end of the interval. Unknown values and ends are
    None.
    """
    cells = record["cells"]
    columns = [Column("cell", [cell["cell"] for cell in cells])]
    for quantity in QUANTITIES:
        entries = [cell.get(quantity.key) for cell in cells]
        values = [extract_value(entry) for entry in entries]
        columns.append(Column(quantity.key, values))
        for i, bound_name in enumerate(("low", "high") if quantity.interval else ()):
            bounds = [entry["ci95"][i] if isinstance(entry, Mapping) else None for entry in entries]
            columns.append(
                Column(Quantity(f"{quantity.name}_{bound_name}", quantity.unit).key, bounds)
            )
    return Table("Cells", tuple(columns))

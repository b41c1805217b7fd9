"""The tables of a study: one row a trial, over all arms, and the times that no two runs share."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tetractl.export.files import Tables
from tetractl.export.tables import Columns
from tetractl.study.arm import Arm
from tetractl.study.cells import as_cell
from tetractl.study.load import LoadedStudy
from tetractl.study.row import Row
from tetractl.study.store import Store

TRIALS, TIMES = "trials.csv", "times.csv"


def counted_rows(loaded: LoadedStudy, store: Store) -> Iterator[tuple[Arm, Row]]:
    """Yield every row of the study in the order of arms and trials."""
    for arm in loaded.arms:
        rows = store.rows[arm.name]
        for trial in range(loaded.study.trials.count):
            if trial in rows:
                yield arm, rows[trial]


def write_tables(loaded: LoadedStudy, store: Store) -> list[Path]:
    """Write the tables and return their paths; the same rows give the same `trials.csv`.

    Its columns are `log` (a path from the study's folder, empty where no log was kept), `trial`,
    `arm`, `controller`, the swept fields by their paths, those of `tetractl export`, `trial_digest`
    and `code`. `times.csv` has what differs from run to run.
    """
    found = list(counted_rows(loaded, store))
    paths = {"trials": store.folder / TRIALS, "times": store.folder / TIMES}
    names = {
        "trials": dict.fromkeys(name for _, row in found for name in row.columns),
        "times": dict.fromkeys(name for _, row in found for name in row.times),
    }
    with Tables(paths, "csv") as tables:
        for arm, row in found:
            log = f"{arm.name}/trial-{row.trial:03d}.mcap" if row.logged else ""
            head: dict[str, Any] = {"arm": arm.name}
            swept = {path: as_cell(arm.values.get(path)) for path in loaded.paths}
            columns = {name: row.columns.get(name) for name in names["trials"]}
            tail = {"trial_digest": row.trial_digest, "code": row.code}
            cells = head | {"controller": arm.controller} | swept | columns | tail
            tables.add(log, row.trial, "trials", _one(cells))
            times = {name: row.times.get(name) for name in names["times"]}
            tables.add(log, row.trial, "times", _one(head | times))
    return list(paths.values())


def _one(cells: dict[str, Any]) -> Columns:
    return {name: [value] for name, value in cells.items()}

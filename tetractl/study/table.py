"""The tables of a study: one row per trial over all arms, times, and the errors of each arm."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from tetractl.core.table.files import TableFiles
from tetractl.core.table.numbers import NONE
from tetractl.core.table.table import Column, Table
from tetractl.log.read.origin import Origin
from tetractl.results.tables import error_table
from tetractl.study.arm import Arm
from tetractl.study.cells import as_cell
from tetractl.study.effect import error_of
from tetractl.study.load import LoadedStudy
from tetractl.study.row import Row
from tetractl.study.store import Store

TRIALS, TIMES = "trials.csv", "times.csv"
MOST = 100  # arms that are printed


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
    paths = {"trials": store.folder / TRIALS, "times": store.folder / TIMES}
    found = list(counted_rows(loaded, store))
    columns = dict.fromkeys(name for _, row in found for name in row.columns)
    trials: list[dict[str, Any]] = []
    times: list[dict[str, Any]] = []
    for arm, row in found:
        log = f"{arm.name}/trial-{row.trial:03d}.mcap" if row.logged else ""
        head = {"log": log, "trial": row.trial, "arm": arm.name}
        swept = {path: as_cell(arm.values.get(path)) for path in loaded.paths}
        same = {name: row.columns.get(name) for name in columns}
        tail = {"trial_digest": row.trial_digest, "code": row.code}
        trials.append(head | {"controller": arm.controller} | swept | same | tail)
        times.append(head | dict(row.times))
    with TableFiles(paths, "csv") as files:
        if found:
            files.add("trials", Table.of_records("trials", trials))
            files.add("times", Table.of_records("times", times))
    return list(paths.values())


def arms_table(loaded: LoadedStudy, store: Store) -> Table:
    """Return the total error of each arm, what aborted, and the plant."""
    arms = loaded.arms[:MOST]
    named = [(arm.name, error_of(loaded, store, [arm])) for arm in arms]
    aborted, plants = [], []
    for arm in arms:
        rows = [store.rows[arm.name].get(i) for i in range(loaded.study.trials.count)]
        aborted.append(sum(row is not None and not row.complete for row in rows))
        plants.append(next((str(row.columns["origin"]) for row in rows if row is not None), NONE))
    errors = error_table(f"{loaded.study.name}: total error [{loaded.unit}]", named, loaded.unit)
    notes = []
    if Origin.DISTURBED in plants:
        notes.append("disturbances are assumed in the spec, not measured")
    if len(loaded.arms) > MOST:
        more = len(loaded.arms) - MOST
        notes.append(f"and {more} arms more, which the table of trials has")
    first, n, mean, std, *_, interval = errors.columns
    columns = (
        replace(first, name="arm", unit=""),
        n,
        mean,
        interval,
        std,
        Column("aborted", aborted),
        Column("plant", plants, words=True),
    )
    return replace(errors, columns=columns, note="; ".join(notes))

"""The tables of a study: one row per trial of every arm, and the total error by arm or field."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tetractl.core.clock import MILLISECOND
from tetractl.core.commands import PlantInfo
from tetractl.core.table.table import Column, Table
from tetractl.core.table.table_files import table_files
from tetractl.log.read.trial_log import Origin, ResultSummary
from tetractl.results.estimate import ArmErrors, numeric
from tetractl.results.open_batch import GIVEN_DIRECTIONS, Batch, counts, directions_given
from tetractl.results.tables import error_table, processors_note
from tetractl.results.trial_tables import trials_table
from tetractl.run.store import Store
from tetractl.study.load_study import Arm, LoadedStudy, as_cell, as_yaml, shown

TRIALS, TIMES = "trials.csv", "times.csv"
HOST_COLUMNS = ("deadline_misses",)
"""Columns of `export` that differ between two runs of a trial; only `times.csv` has them."""
LISTED = 100  # largest number of arms in the printed table


def finished_trials(loaded: LoadedStudy, store: Store) -> Iterator[tuple[Arm, ResultSummary]]:
    """Yield every finished trial of the study in the order of arms and trials."""
    for arm in loaded.arms:
        for _, found in sorted(store.batches[arm.name].results.items()):
            yield arm, found


def origins(loaded: LoadedStudy) -> list[Origin]:
    """Return the origin of each arm's trials, which are all simulated."""
    simulated = PlantInfo("", simulated=True, camera_rate_hz=0.0, facts={})
    return [Origin.of(arm.spec.experiment, simulated) for arm in loaded.arms]


def write_tables(loaded: LoadedStudy, store: Store) -> list[Path]:
    """Write the tables and return their paths; the same results give the same `trials.csv`.

    The columns of `trials.csv` are `log` (its path, from the study's folder), `trial`, `arm`,
    `controller`, the swept fields by their paths, all columns of `tetractl export`,
    `content_digest` and `code`. `times.csv` has the columns that differ from run to run.
    """
    paths = {"trials": store.folder / TRIALS, "times": store.folder / TIMES}
    trials: list[dict[str, Any]] = []
    times: list[dict[str, Any]] = []
    for arm, trial in finished_trials(loaded, store):
        found = _exported(trial)
        log = Path(trial.log).relative_to(store.folder)
        head = {"log": str(log), "trial": trial.trial, "arm": arm.name}
        swept = {path: as_cell(arm.values.get(path)) for path in loaded.paths}
        tail = {"content_digest": trial.digest, "code": trial.code}
        repeats = {key: value for key, value in found.items() if key not in HOST_COLUMNS}
        trials.append(head | {"controller": arm.controller} | swept | repeats | tail)
        times.append(head | {key: found[key] for key in HOST_COLUMNS} | _times(trial))
    with table_files(paths) as add:
        if trials:
            add("trials", Table.of_records("trials", trials), "")
            add("times", Table.of_records("times", times), "")
    return list(paths.values())


def _exported(trial: ResultSummary) -> dict[str, Any]:
    """Return a trial's values by the columns of `tetractl export`, except `log` and `trial`."""
    table = trials_table(Batch.of([trial]))
    return {one.key: one.known[0] for one in table.columns if one.name not in ("log", "trial")}


def _times(trial: ResultSummary) -> dict[str, Any]:
    solve_ms = [ns / MILLISECOND for ns in trial.result.solve_ns]
    return {
        "solve_mean_ms": sum(solve_ms) / len(solve_ms) if solve_ms else None,
        "solve_max_ms": max(solve_ms, default=None),
    }


def group_of(loaded: LoadedStudy, store: Store, value: Any, arms: Sequence[Arm]) -> ArmErrors:
    """Describe the total error over the trials that have a result in all `arms`.

    Trials with the same number have the same seed in every arm, so their mean over the arms counts
    as one observation. If each trial counted separately, the interval would be too short.
    """
    errors = [
        {
            number: trial.result.total_error
            for number, trial in store.batches[arm.name].results.items()
            if counts(trial)
        }
        for arm in arms
    ]
    trials = sorted(set.intersection(*(set(found) for found in errors)))
    means = np.array([np.mean([found[trial] for found in errors]) for trial in trials], dtype=float)
    bound = arms[0].spec.experiment.error_bound
    return ArmErrors.of(value, shown(value), len(arms), means, bound)


def field_values(
    loaded: LoadedStudy, store: Store, path: str, arms: Iterable[Arm]
) -> list[ArmErrors]:
    """Return the arms that set field `path`, grouped by its value, numbers in rising order."""
    found: dict[str, list[Arm]] = {}
    for arm in arms:
        if path in arm.values:
            found.setdefault(as_yaml(arm.values[path]), []).append(arm)
    made = [group_of(loaded, store, several[0].values[path], several) for several in found.values()]
    return sorted(made, key=lambda group: group.value) if numeric(made) else made


def given_note(arms: Sequence[Arm]) -> str:
    """Return which of several arms were given their directions, "" for none."""
    given = [arm.name for arm in arms if directions_given(arm.spec.experiment)]
    return f"{GIVEN_DIRECTIONS}: {', '.join(given)}" if given else ""


def arms_table(loaded: LoadedStudy, store: Store) -> Table:
    """Return the table of arms: total error, aborted trials, and plant."""
    arms, plants = loaded.arms[:LISTED], origins(loaded)[:LISTED]
    named = [(arm.name, group_of(loaded, store, arm.name, [arm]).error) for arm in arms]
    found = list(finished_trials(loaded, store))
    aborted = Counter(arm.name for arm, trial in found if not trial.outcome.complete)
    errors = error_table(f"{loaded.study.name}: total error [{loaded.unit}]", named, loaded.unit)
    notes = [processors_note(trial.processor for _, trial in found)]
    notes.append(given_note(arms))
    if Origin.DISTURBED in plants:
        notes.append("disturbances are assumed in the spec, not measured")
    if len(loaded.arms) > LISTED:
        more = len(loaded.arms) - LISTED
        notes.append(f"and {more} more arms, listed in the table of trials")
    first, n, mean, std, *_, interval = errors.columns
    tails = [error.tail for _, error in named]
    above = [Column(tails[0].label, [tail.text() for tail in tails])]
    columns = (
        replace(first, name="arm", unit=""),
        n,
        mean,
        interval,
        std,
        *(above if any(tail.above for tail in tails) else []),
        Column("aborted", [aborted[arm.name] for arm in arms]),
        Column("plant", [str(plant) for plant in plants], words=True),
    )
    return replace(errors, columns=columns, note="; ".join(filter(None, notes)))

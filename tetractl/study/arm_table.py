"""The tables of a study: one row per trial of every arm, and the total error by arm or field."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tetractl.core.clock import MILLISECOND
from tetractl.core.trial import PlantInfo
from tetractl.log.read.trial_log import Origin, ResultSummary
from tetractl.results.estimate import ArmErrors, numeric
from tetractl.results.open_batch import GIVEN_DIRECTIONS, Batch, counts, directions_given
from tetractl.results.tables import error_table, processors_note
from tetractl.results.trial_tables import trials_table
from tetractl.run.store import Store
from tetractl.study.load_study import Arm, LoadedStudy, as_yaml, shown
from tetractl.tools.table.table import Column, Table
from tetractl.tools.table.table_files import table_files

TRIALS = "trials.csv"
"""Name of the table of what is repeatable."""
TIMES = "times.csv"
"""Name of the table of what differs from run to run."""
HOST_COLUMNS = ("deadline_misses",)
"""Columns of `export` that differ between two runs of a trial; only `times.csv` has them."""
LISTED = 100
"""Largest number of arms in the printed table."""


def finished_trials(loaded: LoadedStudy, store: Store) -> Iterator[tuple[Arm, ResultSummary]]:
    """Yield every finished trial of the study in the order of arms and trials."""
    for arm in loaded.arms:
        results = store.batches[arm.name].results
        for number in sorted(results):
            yield arm, results[number]


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
        log = Path(trial.log).relative_to(store.folder)
        name = {"log": str(log), "trial": trial.trial, "arm": arm.name}
        of_host: dict[str, Any] = {}
        repeatable: dict[str, Any] = {}
        for column in trials_table(Batch.of([trial])).columns:
            if column.name not in ("log", "trial"):
                cells = of_host if column.key in HOST_COLUMNS else repeatable
                cells[column.key] = column.known[0]
        swept: dict[str, Any] = {}
        for path in loaded.paths:
            value = arm.values.get(path)
            is_cell = isinstance(value, int | float | str) or value is None
            swept[path] = value if is_cell else as_yaml(value)
        sources = {"content_digest": trial.digest, "code": trial.code}
        trials.append(name | {"controller": arm.controller} | swept | repeatable | sources)
        times.append(name | of_host | _times(trial))
    with table_files(paths) as add:
        if trials:
            add("trials", Table.of_records("trials", trials), "")
            add("times", Table.of_records("times", times), "")
    return list(paths.values())


def _times(trial: ResultSummary) -> dict[str, Any]:
    """Return the times that a trial's steps took [ms]."""
    solve_ms = [ns / MILLISECOND for ns in trial.result.solve_ns]
    return {
        "solve_mean_ms": sum(solve_ms) / len(solve_ms) if solve_ms else None,
        "solve_max_ms": max(solve_ms, default=None),
    }


def group_of(store: Store, value: Any, arms: Sequence[Arm]) -> ArmErrors:
    """Describe the total error over the trials that have a result in all `arms`.

    Trials with the same number have the same seed in every arm, so their mean over the arms counts
    as one observation. If each trial counted separately, the interval would be too short.
    """
    errors: list[dict[int, float]] = []  # of each arm, by the number of the trial
    for arm in arms:
        trials = store.batches[arm.name].results.items()
        errors.append({n: trial.result.total_error for n, trial in trials if counts(trial)})
    in_all = set.intersection(*map(set, errors))
    means: list[float] = []
    for number in sorted(in_all):
        over_arms = [of_arm[number] for of_arm in errors]
        means.append(float(np.mean(over_arms)))
    bound = arms[0].spec.experiment.error_bound
    label = shown(value)
    return ArmErrors.of(value, label, len(arms), np.array(means), bound)


def field_values(store: Store, path: str, arms: Iterable[Arm]) -> list[ArmErrors]:
    """Return the arms that set field `path`, grouped by its value, numbers in rising order."""
    arms_of: dict[str, list[Arm]] = {}  # by the value as text, as values may be lists
    for arm in arms:
        if path in arm.values:
            arms_of.setdefault(as_yaml(arm.values[path]), []).append(arm)
    groups = [
        group_of(store, same_value[0].values[path], same_value) for same_value in arms_of.values()
    ]
    if numeric(groups):
        groups.sort(key=lambda group: group.value)
    return groups


def given_note(arms: Sequence[Arm]) -> str:
    """Return which of several arms were given their directions, "" for none."""
    names = [arm.name for arm in arms if directions_given(arm.spec.experiment)]
    return f"{GIVEN_DIRECTIONS}: {', '.join(names)}" if names else ""


def arms_table(loaded: LoadedStudy, store: Store) -> Table:
    """Return the table of arms: total error, aborted trials, and plant."""
    arms = loaded.arms[:LISTED]
    plants = origins(loaded)[:LISTED]
    trials = list(finished_trials(loaded, store))
    aborted = Counter(arm.name for arm, trial in trials if not trial.outcome.complete)
    errors = {arm.name: group_of(store, arm.name, [arm]).error for arm in arms}
    table = error_table(
        f"{loaded.study.name}: total error [{loaded.unit}]", list(errors.items()), loaded.unit
    )
    of_error = {column.name: column for column in table.columns}
    columns = [
        Column("arm", list(errors)),
        of_error["n"],
        of_error["mean"],
        of_error["95 % interval"],
        of_error["std"],
    ]
    tails = [error.tail for error in errors.values()]
    if any(tail.above for tail in tails):
        columns.append(Column(tails[0].label, [tail.text() for tail in tails]))
    columns.append(Column("aborted", [aborted[arm.name] for arm in arms]))
    columns.append(Column("plant", [str(plant) for plant in plants], words=True))
    notes = [processors_note(trial.processor for _, trial in trials), given_note(arms)]
    if Origin.DISTURBED in plants:
        notes.append("disturbances are assumed in the spec, not measured")
    if len(loaded.arms) > LISTED:
        more = len(loaded.arms) - LISTED
        notes.append(f"and {more} more arms, listed in the table of trials")
    return Table(table.title, tuple(columns), "; ".join(note for note in notes if note))

"""The tables of a study: one row per trial of every arm, and the total error by arm or field."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tetractl.core.trial import PlantInfo
from tetractl.log.read.trial_log import Origin, ResultSummary
from tetractl.run.store import Store
from tetractl.statistics.estimate import ArmErrors, are_numeric
from tetractl.statistics.flagged import SAFETY, unsafe_robots
from tetractl.statistics.open_batch import Batch, is_counted
from tetractl.statistics.tables import GIVEN_DIRECTIONS, error_table
from tetractl.statistics.trial_tables import trials_table
from tetractl.study.load_study import Arm, LoadedStudy, as_yaml, format_value
from tetractl.tools.table.table import Column, Table
from tetractl.tools.table.table_files import open_table_files

TRIALS_FILE = "trials.csv"
"""Name of the file with the table of all trials, which has the same bytes in every run."""
EXCLUDED_COLUMNS = ("log", "trial", "deadline_misses")
"""Columns of `tetractl export` that this table leaves out.

The table has them in another form, or they differ from run to run.
"""
ARMS_LISTED_MAX = 100
"""Maximum number of arms in the printed table."""


def finished_trials(loaded: LoadedStudy, store: Store) -> Iterator[tuple[Arm, ResultSummary]]:
    """Yield every finished trial of a study with its arm, in the order of the arms.

    The trials of an arm are sorted by their index. Aborted trials are included, missing ones
    are not.
    """
    for arm in loaded.arms:
        results = store.batches[arm.name].results
        for number in sorted(results):
            yield arm, results[number]


def arm_origins(loaded: LoadedStudy) -> list[Origin]:
    """Return the origin of each arm's trials, which are all simulated."""
    simulated = PlantInfo("", simulated=True, camera_rate_hz=0.0, facts={})
    return [Origin.from_spec(arm.spec.experiment, simulated) for arm in loaded.arms]


def write_table(loaded: LoadedStudy, store: Store) -> Path:
    """Write the table of all trials of a study, `trials.csv`, and return its path.

    The same results give the same bytes. The columns are `log` (the path from the study's folder),
    `trial`, `arm`, `controller`, the swept fields by their paths, all columns of `tetractl export`
    that do not differ from run to run, `content_digest` and `code`.
    """
    rows: list[dict[str, Any]] = []
    for arm, trial in finished_trials(loaded, store):
        log = Path(trial.log).relative_to(store.folder)
        row = {"log": str(log), "trial": trial.trial, "arm": arm.name, "controller": arm.controller}
        for path in loaded.paths:
            value = arm.values.get(path)
            is_cell = isinstance(value, int | float | str) or value is None
            row[path] = value if is_cell else as_yaml(value)
        for column in trials_table(Batch.from_results([trial])).columns:
            if column.key not in EXCLUDED_COLUMNS:
                row[column.key] = column.listed[0]
        rows.append(row | {"content_digest": trial.digest, "code": trial.code})
    path = store.folder / TRIALS_FILE
    with open_table_files({"trials": path}) as add:
        if rows:
            add("trials", Table.of_records("trials", rows), "")
    return path


def group_errors(store: Store, value: Any, arms: Sequence[Arm]) -> ArmErrors:
    """Compute the total errors of all trials of a study with one value of a swept field.

    Only trials that have a result in all of these arms count. Trials with the same number have the
    same seed in every arm, so their mean over the arms counts as one observation. If each trial
    counted separately, the interval would be too short.

    Args:
        store: The folder of the study.
        value: Value of the swept field.
        arms: The arms with that value.
    """
    errors_by_arm: list[dict[int, float]] = []  # of each arm, by the number of the trial
    for arm in arms:
        trials = store.batches[arm.name].results.items()
        errors_by_arm.append(
            {n: trial.result.total_error for n, trial in trials if is_counted(trial)}
        )
    common_trials = set.intersection(*map(set, errors_by_arm))
    means: list[float] = []
    for number in sorted(common_trials):
        trial_errors = [of_arm[number] for of_arm in errors_by_arm]
        means.append(float(np.mean(trial_errors)))
    bound = arms[0].spec.experiment.error_bound
    label = format_value(value)
    return ArmErrors.from_errors(value, label, len(arms), np.array(means), bound)


def group_by_value(store: Store, path: str, arms: Iterable[Arm]) -> list[ArmErrors]:
    """Group the arms of a study by the value that they give to one field.

    Numbers are in ascending order.

    Args:
        store: The folder of the study.
        path: The field.
        arms: The arms.
    """
    arms_by_value: dict[str, list[Arm]] = {}  # by the value as text, as values may be lists
    for arm in arms:
        if path in arm.values:
            arms_by_value.setdefault(as_yaml(arm.values[path]), []).append(arm)
    groups = [
        group_errors(store, same_value[0].values[path], same_value)
        for same_value in arms_by_value.values()
    ]
    if are_numeric(groups):
        groups.sort(key=lambda group: group.value)
    return groups


def given_directions_note(arms: Sequence[Arm]) -> str:
    """Name the arms whose directions were given, instead of decided by a controller.

    The note is empty if there is no such arm.
    """
    names = [arm.name for arm in arms if arm.spec.experiment.gives_directions]
    return f"{GIVEN_DIRECTIONS}: {', '.join(names)}" if names else ""


def unsafe_columns(
    names: Iterable[str], trials: Iterable[tuple[Arm, ResultSummary]]
) -> list[Column]:
    """Return one column for each kind of unsafe event in SAFETY that occurred.

    A column lists in how many trials of each arm the event occurred.
    """
    counts_by_label = {label: Counter[str]() for label in SAFETY}
    for arm, trial in trials:
        for label in unsafe_robots(trial):
            counts_by_label[label][arm.name] += 1
    arm_names = list(names)
    return [
        Column(label, [count_by_arm[name] for name in arm_names])
        for label, count_by_arm in counts_by_label.items()
        if count_by_arm
    ]


def arms_table(loaded: LoadedStudy, store: Store) -> Table:
    """Return a table with one row per arm: total error, unsafe and aborted trials, and plant.

    It has at most ARMS_LISTED_MAX rows. A note below it gives the number of arms that are left out.
    """
    arms = loaded.arms[:ARMS_LISTED_MAX]
    plants = arm_origins(loaded)[:ARMS_LISTED_MAX]
    trials = list(finished_trials(loaded, store))
    aborted = Counter(arm.name for arm, trial in trials if not trial.outcome.complete)
    errors = {arm.name: group_errors(store, arm.name, [arm]).error for arm in arms}
    table = error_table(
        f"{loaded.study.name}: total error [{loaded.unit}]", list(errors.items()), loaded.unit
    )
    error_columns = {column.name: column for column in table.columns}
    columns = [
        Column("arm", list(errors)),
        error_columns["n"],
        error_columns["mean"],
        *unsafe_columns(errors, trials),  # before what a narrow terminal leaves out
        error_columns["95 % interval"],
        error_columns["std"],
    ]
    tails = [error.tail for error in errors.values()]
    if any(tail.above for tail in tails):
        columns.append(Column(tails[0].label, [tail.text() for tail in tails]))
    columns.append(Column("aborted", [aborted[arm.name] for arm in arms]))
    columns.append(Column("plant", [str(plant) for plant in plants], words=True))
    notes = [given_directions_note(arms)]
    if Origin.DISTURBED in plants:
        notes.append("disturbances are assumed in the spec, not measured")
    if len(loaded.arms) > ARMS_LISTED_MAX:
        omitted_count = len(loaded.arms) - ARMS_LISTED_MAX
        notes.append(f"and {omitted_count} more arms, listed in the table of trials")
    return Table(table.title, tuple(columns), "; ".join(note for note in notes if note))

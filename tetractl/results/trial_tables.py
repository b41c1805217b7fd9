"""The tables of trials: one row per trial or, of one trial, per control step, pose, estimate or
event.

The unit of a column is in its name: s, ms, rad, rad/s, or the length unit of the experiment, such
as mm and mm/s. Times count from the first direction sent. `path` (of the log) and `trial` are in
every table of `tetractl export`, so that tables can be joined.
"""

from collections.abc import Callable, Container, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from tetractl.core.plan import Estimate
from tetractl.core.poses import Floats
from tetractl.core.table.table import Column, Table
from tetractl.log.read.reader import result_of, trial_of
from tetractl.log.read.salvage import scan
from tetractl.log.read.trial_log import Damage, ResultSummary, TrialLog
from tetractl.results.describe import trial_items
from tetractl.results.open_batch import Batch

_WORDS = ("robot", "level", "text", "stopped", "outcome", "origin", "reason")


def trials_table(batch: Batch) -> Table:
    """Return one row per trial, then one row per earlier attempt, with `attempt` True.

    The names of lengths end in their unit.
    """
    counted = [_row(trial) | {"attempt": False} for trial in batch.trials]
    attempts = [_row(one) | {"attempt": True, "counted": False} for one in batch.attempts]
    return Table.of_records("trials", [*counted, *attempts])


def _row(trial: ResultSummary) -> dict[str, Any]:
    """Return the row of one trial: its values by the names of the columns."""
    fields, unit = trial_items(trial), trial.experiment.units.length
    total, errors = fields.pop("total_error"), fields.pop("robot_errors")
    names = (f"error_{robot.name}_{unit}" for robot in trial.experiment.robots)
    return {**fields, f"total_error_{unit}": total, **dict(zip(names, errors, strict=True))}


def steps(log: TrialLog) -> Table:
    """Return one row per control step k: the direction sent, its plan and its searches.

    Columns that begin with `left_NAME` and `right_NAME` are the wheel speeds of robot NAME by the
    paper's equations (24)-(25); `delivered_NAME` is False if the plant knows that the command did
    not reach it.
    """
    setup, found = log.start.setup, log.steps
    columns: dict[str, Any] = {
        "k": [step.k for step in found],
        "time_s": [log.elapsed_s(step.command.sent_ns) for step in found],
        "observed_s": [log.elapsed_s(step.observation.sampled_ns) for step in found],
        "direction_rad": [step.command.direction for step in found],
        "cost": [step.plan.cost for step in found],
        "target_cost": [step.plan.target_cost for step in found],
        "obstacle_cost": [step.plan.obstacle_cost for step in found],
        "signals": [len(step.plan.signals) for step in found],
        "searches": [len(step.plan.searches) for step in found],
        "iterations": [len(step.plan.search.history) - 1 for step in found],
        "evaluations": [step.plan.evaluations for step in found],
        "stopped": [str(step.plan.search.stopped) for step in found],
        "solve_ms": [step.solve_ns / 1e6 for step in found],
        "deadline_missed": [step.deadline_missed for step in found],
    }
    for i, name in enumerate(setup.names):
        columns[f"delivered_{name}"] = [step.command.delivered[i] for step in found]
    for i, name in enumerate(setup.names if setup.wheel_radius is not None else ()):
        for side in ("left", "right"):
            speeds = [step.command.left if side == "left" else step.command.right for step in found]
            columns[f"{side}_{name}_{setup.unit}_s"] = [
                None if one is None else float(one[i]) for one in speeds
            ]
    return _table("steps", columns)


def poses(log: TrialLog) -> Table:
    """Return one row per camera frame and robot: the measured pose, and a simulation's true one.

    `valid` is False if the robot was not tracked.
    """
    setup, frames = log.start.setup, len(log.frames)
    unit, robots = setup.unit, len(setup.names)
    columns: dict[str, Any] = {
        "time_s": np.repeat((log.mocap_ns - log.began_ns) / 1e9, robots),
        "frame": np.repeat(log.frames, robots),
        "robot": np.tile(setup.names, frames),
    }
    truth = np.full_like(log.mocap, np.nan) if log.truth is None else log.truth
    for prefix, known in (("", log.mocap), ("true_", truth)):
        for i, name in enumerate((f"x_{unit}", f"y_{unit}", "heading_rad")):
            columns[prefix + name] = known[..., i].ravel()
    columns["valid"] = log.valid.ravel()
    columns[f"distance_{unit}"] = setup.distances(log.mocap[..., :2]).ravel()
    return _table("poses", columns)


def estimates(log: TrialLog) -> Table:
    """Return one row per control step and robot: the controller's estimates and their standard
    deviations."""
    setup = log.start.setup
    of: dict[str, Callable[[Estimate], Floats | float | None]] = {
        "a_rad_s": lambda found: found.a,
        "a_std_rad_s": lambda found: found.a_std,
        f"speed_{setup.unit}_s": lambda found: found.speed,
        f"speed_std_{setup.unit}_s": lambda found: found.speed_std,
        "heading_bias_rad": lambda found: found.heading_bias,
        "heading_bias_std_rad": lambda found: found.heading_bias_std,
        "dead_time_s": lambda found: found.dead_time,
        "dead_time_std_s": lambda found: found.dead_time_std,
        "misfit": lambda found: None if found.misfit is None else found.misfit.max(axis=1),
    }
    known = [(step, found) for step in log.steps if (found := step.plan.estimate) is not None]
    robots = len(setup.names)
    times = [log.elapsed_s(step.command.sent_ns) for step, _ in known]
    columns: dict[str, Any] = {
        "k": np.repeat([step.k for step, _ in known], robots),
        "time_s": np.repeat(times, robots),
        "robot": np.tile(setup.names, len(known)),
    }
    for name, get in of.items():
        rows = np.full((len(known), robots), np.nan)
        for row, (_, found) in zip(rows, known, strict=True):
            row[:] = np.nan if (one := get(found)) is None else one
        columns[name] = rows.ravel()
    return _table("estimates", columns)


def events(log: TrialLog) -> Table:
    """Return one row per event, such as a lost command, lost tracking, or the end of the trial."""
    keys = ("time_s", "level", "text")
    return _table("events", {key: [asdict(one)[key] for one in log.events] for key in keys})


OF_TRIAL: Mapping[str, Callable[[TrialLog], Table]] = {
    "steps": steps,
    "poses": poses,
    "estimates": estimates,
    "events": events,
}
TABLES = ("trials", *OF_TRIAL)


def of_log(path: Path, names: Container[str]) -> tuple[dict[str, Table], Damage | None]:
    """Return the named tables of a log, each with the columns `path` and `trial` in front, and
    its damage.

    Raises LogError if the log cannot be read.
    """
    contents, found = scan(path), dict[str, Table]()
    if "trials" in names:
        found["trials"] = trials_table(Batch.of([result_of(contents)]))
    log = trial_of(contents)
    if any(name in names for name in OF_TRIAL):
        found |= {
            name: table(log).with_first(path=str(path), trial=log.start.trial)
            for name, table in OF_TRIAL.items()
            if name in names
        }
    return found, log.damage


def _table(name: str, columns: Mapping[str, Any]) -> Table:
    return Table(
        name, tuple(Column(key, values, words=key in _WORDS) for key, values in columns.items())
    )

"""The tables of trials: one row per trial or, of one trial, per control step, pose, estimate or
event.

The unit of a column is in its name: s, ms, rad, rad/s, or the length unit of the experiment, such
as mm and mm/s. Times count from the first direction sent. `log` (its file) and `trial` are in
every table of `tetractl export`, so that tables can be joined.
"""

import math
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.errors import printable
from tetractl.core.plan import INNOVATIONS
from tetractl.core.poses import Floats, Integers
from tetractl.core.table.table import Column, Table
from tetractl.log.format.channels import HOST_TIMING, STEP
from tetractl.log.format.codec import OF_ESTIMATE, STOP_REASON_MAX
from tetractl.log.format.tetractl_pb2 import StepTiming
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.reader import result_of, trial_of, whole, written
from tetractl.log.read.salvage import scan
from tetractl.log.read.trial_log import Damage, ResultSummary, TrialLog
from tetractl.results.describe import trial_items
from tetractl.results.open_batch import Batch

_DISTANCES = ("clearance", "edge", "apart")
"""The lengths among the values of a trial, next to its errors."""
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
    named = {f"{key}_{unit}" if key in _DISTANCES else key: fields[key] for key in fields}
    names = (f"error_{robot.name}_{unit}" for robot in trial.experiment.robots)
    return {**named, f"total_error_{unit}": total, **dict(zip(names, errors, strict=True))}


def steps(log: TrialLog, contents: RawLog) -> Table:
    """Return one row per control step k: the direction sent, its plan and its searches.

    Columns that begin with `left_NAME` and `right_NAME` are the wheel speeds of robot NAME by the
    paper's equations (24)-(25); `delivered_NAME` is False if the plant knows that the command did
    not reach it. `lag_s` is the time constant of the wheels by the spec, 0 without one; `identify`
    reads it.
    """
    setup, rows = log.start.setup, list[tuple[Any, ...]]()
    wheels = [f"{side}_{name}_{setup.unit}_s" for name in setup.names for side in ("left", "right")]
    wheels = wheels if setup.wheel_radius is not None else []
    timings = {one.k: one for one in contents.messages(HOST_TIMING)}
    for step in contents.messages(STEP):
        sent, searches, timing = step.command, step.searches, timings.get(step.k, StepTiming())
        row = (
            step.k,
            sent.sent_ns,
            step.observation.sampled_ns,
            sent.direction if sent.HasField("direction") else None,
            setup.lag_s,
            step.cost,
            step.target_cost,
            step.obstacle_cost,
            len(step.signals),
            len(searches),
            len(searches[step.chosen].history) - 1,
            sum(one.evaluations for one in searches),
            printable(searches[step.chosen].stopped, STOP_REASON_MAX),
            timing.solve_ns / 1e6,
            timing.deadline_missed,
        )
        speeds = [one for pair in zip(sent.left, sent.right, strict=True) for one in pair]
        speeds = speeds or [None] * len(wheels)
        rows.append((*row, *sent.delivered, *(speeds if wheels else ())))
    cost = (f"cost_{setup.unit}", f"target_cost_{setup.unit}", "obstacle_cost")
    search = ("signals", "searches", "iterations", "evaluations", "stopped")
    of_step = ("k", "time_s", "observed_s", "direction_rad", "lag_s", *cost, *search)
    delivered = (f"delivered_{name}" for name in setup.names)
    names = (*of_step, "solve_ms", "deadline_missed", *delivered, *wheels)
    values = [*zip(*rows, strict=True)] or [()] * len(names)
    columns = dict[str, Any](zip(names, values, strict=True))
    for name in ("time_s", "observed_s"):
        columns[name] = _seconds(log, columns[name])
    return _table("steps", columns)


def poses(log: TrialLog) -> Table:
    """Return one row per camera frame and robot: the measured pose, and a simulation's true one.

    `valid` is False if the robot was not tracked.
    """
    setup, frames = log.start.setup, len(log.frames)
    unit, robots = setup.unit, len(setup.names)
    columns: dict[str, Any] = {
        "time_s": np.repeat(_seconds(log, log.mocap_ns), robots),
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


def estimates(log: TrialLog, contents: RawLog) -> Table:
    """Return one row per control step and robot: the controller's estimates and their standard
    deviations."""
    setup, unit = log.start.setup, log.start.setup.unit
    names = {name: name for name in OF_ESTIMATE} | {
        "a": "a_rad_s",
        "a_std": "a_std_rad_s",
        "speed": f"speed_{unit}_s",
        "speed_std": f"speed_std_{unit}_s",
        "heading_bias": "heading_bias_rad",
        "heading_bias_std": "heading_bias_std_rad",
        "dead_time": "dead_time_s",
        "dead_time_std": "dead_time_std_s",
    }
    width = dict.fromkeys(names, 1) | {"misfit": len(INNOVATIONS)}
    robots, ks, sent = len(setup.names), list[int](), list[int]()
    found: dict[str, list[Any]] = {name: [] for name in names}
    for step in contents.messages(STEP):
        if not step.HasField("estimate"):
            continue
        ks.append(step.k)
        sent.append(step.command.sent_ns)
        known = {field.name: value for field, value in step.estimate.ListFields()}
        for name, values in found.items():
            value = known.get(name, math.nan)
            values += [value] * (robots * width[name]) if isinstance(value, float) else value[:]
    columns: dict[str, Any] = {
        "k": np.repeat(ks, robots),
        "time_s": np.repeat(_seconds(log, sent), robots),
        "robot": np.tile(setup.names, len(ks)),
    }
    for name, values in found.items():
        rows = np.array(values, dtype=float).reshape(len(ks) * robots, width[name])
        columns[names[name]] = rows.max(axis=1)
    return _table("estimates", columns)


def events(log: TrialLog) -> Table:
    """Return one row per event, such as a lost command, lost tracking, or the end of the trial."""
    keys = ("time_s", "level", "text")
    return _table("events", {key: [asdict(one)[key] for one in log.events] for key in keys})


OF_TRIAL: Mapping[str, Callable[[TrialLog, RawLog], Table]] = {
    "steps": steps,
    "poses": lambda log, _: poses(log),
    "estimates": estimates,
    "events": lambda log, _: events(log),
}
TABLES = ("trials", *OF_TRIAL)


def of_log(path: Path, names: Container[str]) -> tuple[dict[str, Table], Damage | None]:
    """Return the named tables of a log, each with the columns `log` and `trial` in front, and
    its damage. Plans are not decoded, so values of theirs that no table shows are not checked.

    Raises LogError if the log cannot be read.
    """
    contents, found = scan(path), dict[str, Table]()
    if "trials" in names:
        found["trials"] = trials_table(Batch.of([result_of(contents)]))
    if any(name in names for name in OF_TRIAL):
        whole(contents)
    log = trial_of(contents, 1)
    for name, table in OF_TRIAL.items():
        if name in names:
            with written(contents):
                rows = table(log, contents)
            found[name] = rows.with_first(log=str(path), trial=log.start.trial)
    return found, log.damage


def _seconds(log: TrialLog, times: Sequence[int] | Integers) -> Floats:
    """Return the times since the first direction [s] at times of the trial's clock [ns]."""
    return (np.array(times, dtype=np.int64) - log.began_ns) / SECOND


def _table(name: str, columns: Mapping[str, Any]) -> Table:
    return Table(
        name, tuple(Column(key, values, words=key in _WORDS) for key, values in columns.items())
    )

"""Create the tables that `tetractl export` writes: trials, steps, poses, estimates and events.

`tetractl stats --format csv` of one batch prints the table of trials, too. Tables have one row for
each trial or, within one trial, for each control step, pose, estimate or event. The unit of a
column is in its name: s, ms, rad, rad/s, or the length unit of the experiment, such as mm and mm/s.
Times count from the first direction sent. Every table has the columns `log` (the log's file) and
`trial`, so that tables can be joined.
"""

from collections.abc import Callable, Container, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tetractl.core.clock import MILLISECOND
from tetractl.core.errors import printable
from tetractl.core.loggable import (
    LOGGED_ESTIMATE_FIELDS,
    NUMBER_NAME_MAX,
    NUMBERS_MAX,
    STOP_REASON_MAX,
)
from tetractl.core.motion_estimate import INNOVATIONS
from tetractl.core.poses import Floats
from tetractl.log.format.channels import HOST_TIMING, STEP
from tetractl.log.format.tetractl_pb2 import (
    ControllerStep,
    Estimate,
    Search,
    StepTiming,
    WheelCommand,
)
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.reader import decode_errors, result_of, trial_of
from tetractl.log.read.salvage import scan
from tetractl.log.read.trial_log import Damage, ResultSummary, TrialLog
from tetractl.statistics.built_in_statistics import LENGTHS
from tetractl.statistics.open_batch import Batch
from tetractl.statistics.statistic import trial_items
from tetractl.tools.table.table import Column, Table

_TEXT_COLUMNS = ("robot", "level", "text", "stopped", "outcome", "origin", "reason")


def trials_table(batch: Batch) -> Table:
    """Return a table with one row per trial, then one row per earlier attempt.

    In the rows of attempts, `attempt` is True. The names of lengths end in their unit.
    """
    trials = [_trial_row(trial) | {"attempt": False} for trial in batch.trials]
    attempts = [_trial_row(trial) | {"attempt": True, "counted": False} for trial in batch.attempts]
    return Table.of_records("trials", [*trials, *attempts])


def _trial_row(trial: ResultSummary) -> dict[str, Any]:
    """Return the row of one trial: its values by the names of the columns, errors last.

    Names of lengths end in the spec's length unit.
    """
    unit = trial.experiment.units.length
    items = trial_items(trial)
    total_error = items.pop("total_error")
    robot_errors = items.pop("robot_errors")
    row = {f"{key}_{unit}" if key in LENGTHS else key: value for key, value in items.items()}
    row[f"total_error_{unit}"] = total_error
    for robot, error in zip(trial.experiment.robots, robot_errors, strict=True):
        row[f"error_{robot.name}_{unit}"] = error
    return row


def steps(log: TrialLog, contents: RawLog) -> Table:
    """Create the table of control steps: the direction sent in each step, its plan and searches.

    The columns `left_NAME` and `right_NAME` are the wheel speeds of robot NAME, by the paper's
    equations (24)-(25). `delivered_NAME` is False if the plant knows that the command did not reach
    the robot. `lag_s` is the time constant of the wheels in the spec, or 0 if the spec gives none;
    `identify` reads it. Columns that begin with `plan_` are `Plan.numbers`.
    """
    timings = {timing.k: timing for timing in contents.messages(HOST_TIMING)}
    no_timing = StepTiming()
    steps = list(contents.messages(STEP))
    rows = [_step_row(log, step, timings.get(step.k, no_timing)) for step in steps]
    no_command = WheelCommand(delivered=[False] * len(log.start.setup.names))
    no_step = ControllerStep(command=no_command, searches=[Search()])
    columns: dict[str, list[Any]] = {}
    for name in _step_row(log, no_step, no_timing):  # a trial without steps has columns, too
        columns[name] = [row[name] for row in rows]
    return _table("steps", columns | _number_columns(steps))


def _step_row(log: TrialLog, step: ControllerStep, timing: StepTiming) -> dict[str, Any]:
    """Return the row of one control step for the table `steps`.

    Times [s] count from the first direction. The direction is None if the step sent none, and wheel
    speeds are None if they are unknown.
    """
    setup = log.start.setup
    command = step.command
    chosen = step.searches[step.chosen]
    row = {
        "k": step.k,
        "time_s": log.elapsed_s(command.sent_ns),
        "observed_s": log.elapsed_s(step.observation.sampled_ns),
        "direction_rad": command.direction if command.HasField("direction") else None,
        "lag_s": command.lag if command.HasField("lag") else setup.lag_s,
        f"cost_{setup.unit}": step.cost,
        f"target_cost_{setup.unit}": step.target_cost,
        "obstacle_cost": step.obstacle_cost,
        "signals": len(step.signals),
        "searches": len(step.searches),
        "iterations": len(chosen.history) - 1,
        "evaluations": sum(search.evaluations for search in step.searches),
        "stopped": printable(chosen.stopped, STOP_REASON_MAX),
        "solve_ms": timing.solve_ns / MILLISECOND,
        "deadline_missed": timing.deadline_missed,
    }
    for robot, delivered in zip(setup.names, command.delivered, strict=True):
        row[f"delivered_{robot}"] = delivered
    if not setup.on_wheels:
        return row
    unknown = [None] * len(setup.names)
    wheels = zip(setup.names, command.left or unknown, command.right or unknown, strict=True)
    for robot, left_speed, right_speed in wheels:
        row[f"left_{robot}_{setup.unit}_s"] = left_speed
        row[f"right_{robot}_{setup.unit}_s"] = right_speed
    return row


def _number_columns(steps: Sequence[ControllerStep]) -> dict[str, list[float | None]]:
    """Return a column for each name of the controller's numbers, as {plan_NAME: values}.

    The value is None at a step without a number of this name. There may be at most NUMBERS_MAX
    names, otherwise ValueError is raised.
    """
    numbers = [{number.name: number.value for number in step.numbers} for step in steps]
    names = dict.fromkeys(name for step_numbers in numbers for name in step_numbers)
    if len(names) > NUMBERS_MAX:
        raise ValueError(f"the controller's numbers have {len(names)} names")
    return {
        f"plan_{printable(name, NUMBER_NAME_MAX)}": [
            step_numbers.get(name) for step_numbers in numbers
        ]
        for name in names
    }


def poses(log: TrialLog) -> Table:
    """Create the table of poses: a row per camera frame and robot, with measured and true pose.

    The true pose is only known in a simulation. `valid` is False if the robot was not tracked.
    """
    setup = log.start.setup
    unit = setup.unit
    n_frames = len(log.frames)
    n_robots = len(setup.names)
    columns: dict[str, Any] = {
        "time_s": np.repeat(log.frames_s, n_robots),
        "frame": np.repeat(log.frames, n_robots),
        "robot": np.tile(setup.names, n_frames),
    }
    truth = np.full_like(log.mocap, np.nan) if log.truth is None else log.truth
    for prefix, poses in (("", log.mocap), ("true_", truth)):
        columns[f"{prefix}x_{unit}"] = poses[..., 0].ravel()
        columns[f"{prefix}y_{unit}"] = poses[..., 1].ravel()
        columns[f"{prefix}heading_rad"] = poses[..., 2].ravel()
    columns["valid"] = log.valid.ravel()
    columns[f"distance_{unit}"] = setup.distances(log.mocap[..., :2]).ravel()
    return _table("poses", columns)


def estimates(log: TrialLog, contents: RawLog) -> Table:
    """Create the table of estimates: a row for each control step and robot.

    The table has the controller's estimates and their standard deviations.
    """
    setup = log.start.setup
    n_robots = len(setup.names)
    steps = [step for step in contents.messages(STEP) if step.HasField("estimate")]
    sent_s = [log.elapsed_s(step.command.sent_ns) for step in steps]
    columns: dict[str, Any] = {
        "k": np.repeat([step.k for step in steps], n_robots),
        "time_s": np.repeat(sent_s, n_robots),
        "robot": np.tile(setup.names, len(steps)),
    }
    units = {
        "a": "rad_s",
        "speed": f"{setup.unit}_s",
        "heading_bias": "rad",
        "dead_time": "s",
        "lag": "s",
    }
    for field in LOGGED_ESTIMATE_FIELDS:
        rows = [_values_by_robot(step.estimate, field, n_robots) for step in steps]
        unit = units.get(field.removesuffix("_std"))
        name = field if unit is None else f"{field}_{unit}"
        columns[name] = np.array(rows, dtype=float).ravel()
    return _table("estimates", columns)


def _values_by_robot(estimate: Estimate, field: str, n_robots: int) -> Floats:
    """Return the values of an estimate's field for all robots, shape (N,).

    The values are NaN if the field is not logged. A single number is repeated for all robots. If a
    robot has several misfits, its value is the largest misfit.
    """
    if field not in {logged.name for logged, _ in estimate.ListFields()}:
        return np.full(n_robots, np.nan)
    values = np.array(getattr(estimate, field), dtype=float)
    if values.ndim == 0:
        return np.full(n_robots, values)
    width = len(INNOVATIONS) if field == "misfit" else 1
    return values.reshape(n_robots, width).max(axis=1)


def events(log: TrialLog) -> Table:
    """Create the table of events, such as lost commands, lost tracking and the end of the trial.

    Times [s] count from the first direction, so they can be negative.
    """
    return _table(
        "events",
        {
            "time_s": [event.time_s for event in log.events],
            "level": [event.level for event in log.events],
            "text": [event.text for event in log.events],
        },
    )


TABLE_FUNCTIONS: Mapping[str, Callable[[TrialLog, RawLog], Table]] = {
    "steps": steps,
    "poses": lambda log, _: poses(log),
    "estimates": estimates,
    "events": lambda log, _: events(log),
}
"""Functions that create the tables of a single trial, by the names of the tables."""
TABLES = ("trials", *TABLE_FUNCTIONS)
"""Names of all tables that `tetractl export` can write."""


def read_tables(path: Path, names: Container[str]) -> tuple[dict[str, Table], Damage | None]:
    """Read the named tables from a log, and return them with the damage of the log.

    Each table has the columns `log` and `trial` in front. Plans are not decoded, so values in plans
    that no table shows are not checked.

    Raises:
        LogError: If the log cannot be read.
    """
    contents = scan(path)
    tables: dict[str, Table] = {}
    if "trials" in names:
        tables["trials"] = trials_table(Batch.from_results([result_of(contents)]))
    log = trial_of(contents, 1)
    for name, table in TABLE_FUNCTIONS.items():
        if name in names:
            with decode_errors(contents):
                rows = table(log, contents)
            tables[name] = rows.with_first(log=str(path), trial=log.start.trial)
    return tables, log.damage


def _table(name: str, columns: Mapping[str, Any]) -> Table:
    described = [Column(key, values, words=key in _TEXT_COLUMNS) for key, values in columns.items()]
    return Table(name, tuple(described))

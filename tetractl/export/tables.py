"""The tables of a trial: one row a control step, a pose, an estimate, an event, a trial.

Every column's name ends in its unit, where it has one: `s`, `ms`, `rad`, `rad_s`, the length unit
of the experiment such as `mm`, and `mm_s`. Times count from the first direction sent. `log` and
`trial` are in every table, so that tables can be joined.
"""

from collections.abc import Callable, Container, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tetractl.log.read.reader import read_result, read_trial
from tetractl.log.read.trial_log import ResultSummary, TrialLog
from tetractl.stats.export import rows

Columns = dict[str, list[Any]]
"""Columns by name, all of the same length; None where a value is not known."""


def steps(log: TrialLog) -> Columns:
    """Return one row a control step k: the direction sent, its plan and its searches.

    `left_NAME` and `right_NAME` are the wheel speeds of (24)-(25), `delivered_NAME` is False where
    the plant knows that a command did not arrive.
    """
    setup, found = log.start.setup, log.steps
    columns: Columns = {
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
    if setup.wheel_radius is not None:
        for i, name in enumerate(setup.names):
            for side in ("left", "right"):
                speeds = [getattr(step.command, side) for step in found]
                columns[f"{side}_{name}_{setup.unit}_s"] = [
                    None if one is None else float(one[i]) for one in speeds
                ]
    return columns


def poses(log: TrialLog) -> Columns:
    """Return one row a camera frame and robot: the measured pose, and the true one of a simulation.

    `valid` is False where the robot was not tracked.
    """
    setup, frames = log.start.setup, len(log.frames)
    unit, robots = setup.unit, len(setup.names)
    columns: dict[str, Any] = {
        "time_s": np.repeat([log.elapsed_s(int(t)) for t in log.mocap_ns], robots),
        "frame": np.repeat(log.frames, robots),
        "robot": np.tile(setup.names, frames),
    }
    unknown = np.full_like(log.mocap, np.nan)
    truth = unknown if log.truth is None else log.truth
    for prefix, known in (("", log.mocap), ("true_", truth)):
        for i, name in enumerate((f"x_{unit}", f"y_{unit}", "heading_rad")):
            columns[prefix + name] = known[..., i].ravel()
    columns["valid"] = log.valid.ravel()
    columns[f"distance_{unit}"] = setup.distances(log.mocap[..., :2]).ravel()
    return {name: _known(values) for name, values in columns.items()}


def estimates(log: TrialLog) -> Columns:
    """Return one row a control step and robot: what the controller estimated, with deviations."""
    setup = log.start.setup
    speed = f"speed_{setup.unit}_s"
    names = (
        "a_rad_s",
        "a_std_rad_s",
        speed,
        f"speed_std_{setup.unit}_s",
        "heading_bias_rad",
        "heading_bias_std_rad",
        "dead_time_s",
        "dead_time_std_s",
    )
    columns: Columns = {name: [] for name in ("k", "time_s", "robot", *names)}
    for step in log.steps:
        if (found := step.plan.estimate) is None:
            continue
        values = (
            found.a,
            found.a_std,
            found.speed,
            found.speed_std,
            found.heading_bias,
            found.heading_bias_std,
            found.dead_time,
            found.dead_time_std,
        )
        for i, robot in enumerate(setup.names):
            columns["k"].append(step.k)
            columns["time_s"].append(log.elapsed_s(step.command.sent_ns))
            columns["robot"].append(robot)
            for name, value in zip(names, values, strict=True):
                one = value[i] if isinstance(value, np.ndarray) else value
                columns[name].append(None if one is None else float(one))
    return columns


def events(log: TrialLog) -> Columns:
    """Return one row an event: a lost command, lost tracking, the reason of the end."""
    found = log.events
    return {
        "time_s": [event.time_s for event in found],
        "level": [event.level for event in found],
        "text": [event.text for event in found],
    }


OF_TRIAL: Mapping[str, Callable[[TrialLog], Columns]] = {
    "steps": steps,
    "poses": poses,
    "estimates": estimates,
    "events": events,
}
TABLES = ("trials", *OF_TRIAL)


def of_log(path: Path, names: Container[str]) -> dict[str, tuple[int, Columns]]:
    """Return the named tables of a log, each with the trial's index in its batch.

    Raises LogError where the log cannot be read.
    """
    found: dict[str, tuple[int, Columns]] = {}
    if "trials" in names:
        result = read_result(path)
        found["trials"] = result.trial, trials(result)
    if any(name in names for name in OF_TRIAL):
        log = read_trial(path)
        found |= {
            name: (log.start.trial, table(log)) for name, table in OF_TRIAL.items() if name in names
        }
    return found


def trials(result: ResultSummary) -> Columns:
    """Return the one row of a trial: what was steered, its errors, outcome and statistics."""
    (values,) = rows([result])
    return {name: [value] for name, value in values.items() if name != "path"}


def _known(values: "np.ndarray[Any, Any]") -> list[Any]:
    """Return an array as a list, None in place of NaN."""
    found = values.tolist()
    if values.dtype.kind == "f" and np.isnan(values).any():
        return [None if value != value else value for value in found]
    return found

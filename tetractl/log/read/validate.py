"""Refuse numbers in a log that no trial can have: arrays of a wrong shape, NaN and infinities.

A checksum shows that a log was not changed, but not that tetractl wrote it. Each function raises
ValueError with the first value that no trial can have. Plans and actions are also checked before
they are logged, because a controller from a plug-in may return anything.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from tetractl.core.commands import Action, Command, Steer, Turn
from tetractl.core.errors import printable
from tetractl.core.motion_estimate import INNOVATIONS, Estimate
from tetractl.core.plan import Plan
from tetractl.core.poses import Floats, Sample
from tetractl.core.trial import Result, Step
from tetractl.log.format import tetractl_pb2 as pb
from tetractl.log.format.channels import TEXT
from tetractl.log.format.codec import (
    ESTIMATE_FIELDS,
    NUMBER_NAME_MAX,
    NUMBERS_MAX,
    Frames,
    drawn,
)
from tetractl.log.format.run_records import decode_result


def check_frames(frames: Frames) -> None:
    """Check camera frames: poses that are `valid`, and true poses that are not NaN."""
    _finite("a pose", frames.poses[frames.valid])
    if np.isinf(frames.poses).any():
        raise ValueError("a pose is infinite")
    if frames.truth is not None:
        _finite("a true pose", frames.truth)


def check_commands(commands: Sequence[Command], robots: int) -> None:
    """Check all commands to N robots together, which is faster than one by one."""
    check_actions([command.action for command in commands])
    for count in {len(command.delivered) for command in commands} - {robots}:
        raise ValueError(f"a command is for {count} robots instead of {robots}")
    sides = [side for command in commands for side in (command.left, command.right)]
    speeds = [side for side in sides if side is not None]
    for count in {len(side) for side in speeds} - {robots}:
        raise ValueError(f"a command has {count} wheel speeds per side for {robots} robots")
    _finite("a wheel's speed", np.concatenate([[], *speeds]))


def check_actions(actions: Iterable[Action]) -> None:
    """Check that all directions of the actions in a log are finite numbers."""
    directions: list[float] = []
    lags: list[float] = []
    for action in actions:
        match action:
            case Steer():
                directions.append(action.direction)
                if action.lag_s is not None:
                    lags.append(action.lag_s)
            case Turn():
                directions.append(action.facing)
            case _:
                pass  # no other action has a direction
    _finite("a direction", directions)
    _finite("the lag of the wheels", lags)


def check_steps(steps: Sequence[Step], robots: int) -> None:
    """Check all control steps of N robots together, which is faster than one by one."""
    check_frames(Frames.from_samples([Sample(step.observation, None) for step in steps], robots))
    check_commands([step.command for step in steps], robots)
    for step in steps:
        check_plan(step.plan, robots)


def check_plan(plan: Plan, robots: int) -> None:
    """Check a plan for N robots. The headings of its path may be NaN."""
    count = plan.signals.size
    if plan.signals.shape != (count,) or plan.path.shape != (count + 1, robots, 3):
        shapes = f"{plan.path.shape} for signals of shape {plan.signals.shape}"
        raise ValueError(f"a path has shape {shapes} and {robots} robots")
    searches = plan.searches
    for search in searches:
        if not (search.signals.shape == (search.length,) and search.length):
            raise ValueError(
                f"a search of length {_shown(search.length)} has a different number of signals"
            )
        if search.history.ndim != 1 or not search.history.size:
            raise ValueError("a search has no history")
        if not isinstance(search.stopped, str):
            raise ValueError(f"a search was stopped by {type(search.stopped).__name__}, not a text")
    if len(plan.numbers) > NUMBERS_MAX:
        raise ValueError(f"a plan has {len(plan.numbers)} numbers of its controller")
    for name in plan.numbers:
        if not (name.isidentifier() and len(name) <= NUMBER_NAME_MAX):
            raise ValueError(f"a number is called {printable(name, NUMBER_NAME_MAX)!r}")
    costs = [plan.cost, plan.target_cost, plan.obstacle_cost]
    costs += [search.cost for search in searches]
    values = {
        "a predicted position": drawn(plan.path[..., :2]).ravel(),
        "a signal": np.concatenate([plan.signals, *(search.signals for search in searches)]),
        "a cost": np.concatenate([costs, *(search.history for search in searches)]),
    }
    values |= {f"the number {name}": [number] for name, number in plan.numbers.items()}
    if plan.estimate is not None:
        values |= _numbers_of_estimate(plan.estimate, robots)
    for what, numbers in values.items():
        _finite(what, numbers)


def _numbers_of_estimate(estimate: Estimate, robots: int) -> dict[str, Floats]:
    """Return all numbers of an estimate of N robots, keyed by their meaning.

    Raises:
        ValueError: If an array is not of N robots.
    """
    values: dict[str, Floats] = {}
    for name in ESTIMATE_FIELDS:
        value = getattr(estimate, name)
        if value is None:
            continue
        if isinstance(value, np.ndarray):
            shape = (robots, len(INNOVATIONS)) if name == "misfit" else (robots,)
            if value.shape != shape:
                raise ValueError(f"an estimated {name} has shape {value.shape}")
        values[f"an estimated {name}"] = np.atleast_1d(value).ravel()
    return values


def stated_result(message: pb.Result, end: pb.HostEnd | None, robots: int, unit: str) -> Result:
    """Return the result that a log contains, with its reason made printable.

    Args:
        message: The message.
        end: The solve times. None if they are missing.
        robots: Number of robots.
        unit: Length unit.

    Raises:
        OverflowError: If a value is one that tetractl does not write.
        ValueError: If a value is one that tetractl does not write.
    """
    result = decode_result(message, end, robots)
    check_result(result)
    if result.drove and len(result.drove) != len(result.solve_ns):
        raise ValueError("the result has another number of solve times than of plans")
    if message.unit != unit:
        raise ValueError(f"the result's unit is {message.unit!r}, not {unit!r}")
    return replace(result, reason=printable(result.reason, TEXT))


def check_result(result: Result) -> None:
    """Check a result. Final poses and errors may be NaN if the trial is not complete."""
    verdict = result.verdict
    lengths = np.array([result.total_error, *result.robot_errors, *verdict.final.xy.ravel()])
    headings = verdict.final.heading
    if not result.outcome.complete:
        lengths = lengths[~np.isnan(lengths)]
        headings = headings[~np.isnan(headings)]
    _finite("a length", lengths)
    _finite("a heading", headings)
    # distances are inf without obstacles or other robots, errors of a turn without a drive
    distances = np.array([*verdict.clearance, *verdict.edge, *verdict.apart, *verdict.turn_std])
    meant = ~np.isposinf(distances)
    _finite("a clearance or an error of a turn", distances[meant])
    _finite("a turn", verdict.turn)
    _finite("duration_s", [result.duration_s])


def _finite(what: str, values: Iterable[float]) -> None:
    """Check that values from a log are finite numbers."""
    numbers = np.asarray(values, dtype=np.float64)
    wrong = numbers[~np.isfinite(numbers)]
    if wrong.size:
        raise ValueError(f"{what} is {float(wrong.flat[0])!r}")


def _shown(number: int) -> str:
    return str(number) if abs(number) < 10**20 else "a number of more than 20 digits"

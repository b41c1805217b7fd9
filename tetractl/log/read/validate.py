"""Refuse numbers in a log that no trial can have: arrays of a wrong shape, NaN and infinities.

A checksum shows that a log was not changed, but not that tetractl wrote it. Each function raises
ValueError with the first value that no trial can have. Plans and actions are checked by
`core.loggable`, also before they are logged.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tetractl.core.commands import Command
from tetractl.core.errors import printable
from tetractl.core.loggable import check_actions, check_plan, require_finite
from tetractl.core.poses import Frames, Sample
from tetractl.core.trial import Result, Step
from tetractl.log.format import tetractl_pb2 as pb
from tetractl.log.format.channels import NOTE_LENGTH_MAX
from tetractl.log.format.run_records import decode_result


def check_frames(frames: Frames) -> None:
    """Check that camera frames contain only values that a trial can have.

    Poses of tracked robots must be finite, and other poses not infinite. True poses must be
    finite.

    Raises:
        ValueError: If a value is not possible.
    """
    require_finite("a pose", frames.poses[frames.valid])
    if np.isinf(frames.poses).any():
        raise ValueError("a pose is infinite")
    if frames.truth is not None:
        require_finite("a true pose", frames.truth)


def check_commands(commands: Sequence[Command], n_robots: int) -> None:
    """Check that commands are for N robots and contain only finite numbers.

    All commands are checked together, which is faster than one by one.

    Raises:
        ValueError: If a command is for another number of robots, or has non-finite numbers.
    """
    check_actions([command.action for command in commands])
    for count in {len(command.delivered) for command in commands} - {n_robots}:
        raise ValueError(f"a command is for {count} robots instead of {n_robots}")
    wheel_speeds_or_none = [
        wheel_speeds for command in commands for wheel_speeds in (command.left, command.right)
    ]
    speeds = [wheel_speeds for wheel_speeds in wheel_speeds_or_none if wheel_speeds is not None]
    for count in {len(wheel_speeds) for wheel_speeds in speeds} - {n_robots}:
        raise ValueError(f"a command has {count} wheel speeds per side for {n_robots} robots")
    require_finite("a wheel's speed", np.concatenate([[], *speeds]))


def check_steps(steps: Sequence[Step], n_robots: int) -> None:
    """Check that control steps contain only values that a trial with N robots can have.

    All steps are checked together, which is faster than one by one.

    Raises:
        ValueError: If a value is not possible.
    """
    check_frames(Frames.from_samples([Sample(step.observation, None) for step in steps], n_robots))
    check_commands([step.command for step in steps], n_robots)
    for step in steps:
        check_plan(step.plan, n_robots)


def stated_result(
    message: pb.Result, host_end: pb.HostEnd | None, n_robots: int, unit: str
) -> Result:
    """Decode and check the result that a log contains, and make its reason printable.

    Args:
        message: The message with the result.
        host_end: The message with the solve times. None if it is missing.
        n_robots: Number of robots.
        unit: The spec's length unit.

    Raises:
        OverflowError: If a value is one that tetractl does not write.
        ValueError: If a value is one that tetractl does not write.
    """
    result = decode_result(message, host_end, n_robots)
    check_result(result)
    if result.drove and len(result.drove) != len(result.solve_ns):
        raise ValueError("the result has another number of solve times than of plans")
    if message.unit != unit:
        raise ValueError(f"the result's unit is {message.unit!r}, not {unit!r}")
    return replace(result, reason=printable(result.reason, NOTE_LENGTH_MAX))


def check_result(result: Result) -> None:
    """Check that a result contains only values that a trial can have.

    Final poses and errors may be NaN only if the trial is not complete.

    Raises:
        ValueError: If a value is not possible.
    """
    verdict = result.verdict
    lengths = np.array([result.total_error, *result.robot_errors, *verdict.final.xy.ravel()])
    headings = verdict.final.heading
    if not result.outcome.complete:
        lengths = lengths[~np.isnan(lengths)]
        headings = headings[~np.isnan(headings)]
    require_finite("a length", lengths)
    require_finite("a heading", headings)
    # distances are inf without obstacles or other robots, and errors of a turn without a drive
    distances = np.array([*verdict.clearance, *verdict.edge, *verdict.apart, *verdict.turn_std])
    is_defined = ~np.isposinf(distances)
    require_finite("a clearance or an error of a turn", distances[is_defined])
    require_finite("a turn", verdict.turn)
    require_finite("duration_s", [result.duration_s])

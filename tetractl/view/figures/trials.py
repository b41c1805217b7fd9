"""Helpers for figures of trials: checks and groups of logs, robots' names, and final poses."""

from collections.abc import Sequence

import numpy as np

from tetractl.core.errors import LogError, UsageError
from tetractl.core.poses import Floats
from tetractl.log.read.trial_log import TrialLog

NUMBERED_MIN = 8
"""Minimum number of robots for which figures show numbers."""
NAME_LENGTH = 16
"""Maximum length of a robot's name [characters]. Longer names are shortened."""


def one_trial(logs: Sequence[TrialLog]) -> TrialLog:
    """Return the only log, for a figure that shows a single trial.

    Raises:
        UsageError: If there are several.
    """
    if len(logs) > 1:
        raise UsageError(
            f"this figure shows a single trial, but {len(logs)} are given",
            "give one log, or use --kind trajectory, errors or batch",
            "give one log, or use kind trajectory, errors or batch",
        )
    return logs[0]


def group_by_folder(logs: Sequence[TrialLog], complete: bool = True) -> dict[str, list[TrialLog]]:
    """Group trials by folder: all trials, or only the complete ones.

    The key is the folder's name, or its path if two folders have the same name.

    Raises:
        UsageError: If the trials' errors are in different units.
        LogError: If there is no trial.
    """
    units = {log.start.setup.unit for log in logs}
    if len(units) > 1:
        raise UsageError(f"errors in {' and '.join(sorted(units))} cannot be drawn on one axis")
    folders: dict[str, list[TrialLog]] = {}
    for log in logs:
        if not complete or not describe_incompleteness(log):
            folder, _, _ = log.log.rpartition("/")
            folders.setdefault(folder, []).append(log)
    if not folders:
        raise LogError("there is no complete trial to plot")
    names = [folder.rpartition("/")[2] or "trials" for folder in folders]
    are_distinct = len(set(names)) == len(names)
    labels = names if are_distinct else list(folders)
    return dict(zip(labels, folders.values(), strict=True))


def check_same_scene(logs: Sequence[TrialLog]) -> None:
    """Check that one figure can show several logs: same arena, obstacles, units and robots.

    Robots that each trial chose by the same rule count as the same.

    Raises:
        UsageError: If they differ.
    """

    def scene(log: TrialLog) -> tuple[object, ...]:
        spec = log.experiment
        return spec.stated_robots, spec.arena, spec.obstacles, spec.units

    for log in logs[1:]:
        if scene(log) != scene(logs[0]):
            raise UsageError(
                f"{logs[0].log} and {log.log} are trials of different experiments",
                "plot only trials with the same robots, arena and obstacles together",
            )


def require_steps(log: TrialLog) -> None:
    """Check that a log has control steps.

    Raises:
        LogError: If it has none.
    """
    if not log.steps:
        raise LogError(f"{log.log}: the log contains no control steps to plot")


def require_frames(log: TrialLog) -> None:
    """Check that a log has camera frames.

    Raises:
        LogError: If it has none.
    """
    if not len(log.mocap_ns):
        raise LogError(f"{log.log}: the log contains no camera frames to plot")


def describe_incompleteness(log: TrialLog) -> str:
    """Describe how and why an incomplete trial ended, or that its log breaks off.

    The result is empty if the trial is complete.
    """
    if log.result is None:
        return "the log breaks off before the end of the trial"
    if log.result.outcome.complete:
        return ""
    return f"{log.result.outcome.value}: {log.result.reason}"


def find_final_poses(log: TrialLog) -> Floats:
    """Find the robots' poses at the end of a trial (N, 3): x, y [length unit], heading [rad].

    These are the final poses in the result. Without a result, they are the last measured poses. A
    robot that was never tracked then has its start as its pose.
    """
    if log.result is not None:
        return log.result.verdict.final.array()
    poses = log.start.setup.starts.array()
    for robot in range(len(poses)):
        frames = np.flatnonzero(log.valid[:, robot])
        if len(frames):
            poses[robot] = log.mocap[frames[-1], robot]
    return poses


def robot_labels(names: Sequence[str]) -> list[str]:
    """Create the labels of robots in a figure, from their names in the same order.

    A name longer than NAME_LENGTH is shortened. If there are NUMBERED_MIN names or more, each label
    starts with the robot's number, from 1.
    """
    short_names = [
        name if len(name) <= NAME_LENGTH else f"{name[: NAME_LENGTH - 1]}…" for name in names
    ]
    if len(names) < NUMBERED_MIN:
        return short_names
    return [f"{number} {name}" for number, name in enumerate(short_names, start=1)]

"""The trials that a figure draws: their selection, their robots' names, and the final poses."""

from collections.abc import Sequence

import numpy as np

from tetractl.core.errors import LogError, UsageError
from tetractl.core.poses import Floats
from tetractl.log.read.trial_log import TrialLog

NUMBERED = 8
"""Minimum number of robots that are numbered."""
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


def by_folder(logs: Sequence[TrialLog], complete: bool = True) -> dict[str, list[TrialLog]]:
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
        if not complete or not unfinished(log):
            folder, _, _ = log.log.rpartition("/")
            folders.setdefault(folder, []).append(log)
    if not folders:
        raise LogError("there is no complete trial to plot")
    names = [folder.rpartition("/")[2] or "trials" for folder in folders]
    distinct = len(set(names)) == len(names)
    labels = names if distinct else list(folders)
    return dict(zip(labels, folders.values(), strict=True))


def check_alike(logs: Sequence[TrialLog]) -> None:
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


def need_steps(log: TrialLog) -> None:
    """Check that a log has control steps.

    Raises:
        LogError: If it has none.
    """
    if not log.steps:
        raise LogError(f"{log.log}: the log contains no control steps to plot")


def need_frames(log: TrialLog) -> None:
    """Check that a log has camera frames.

    Raises:
        LogError: If it has none.
    """
    if not len(log.mocap_ns):
        raise LogError(f"{log.log}: the log contains no camera frames to plot")


def unfinished(log: TrialLog) -> str:
    """Describe how and why an incomplete trial ended, or that its log breaks off.

    The result is empty if complete.
    """
    if log.result is None:
        return "the log breaks off before the end of the trial"
    if log.result.outcome.complete:
        return ""
    return f"{log.result.outcome.value}: {log.result.reason}"


def final_poses(log: TrialLog) -> Floats:
    """Return the final poses (N, 3) in the result: x, y [length unit], heading [rad].

    Without a result, they are the last accepted poses or, for a robot that was never tracked, its
    start.
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
    """Return the robots' names for a figure, in the same order.

    A name longer than NAME_LENGTH is shortened. If there are NUMBERED names or more, each is
    preceded by its number, from 1.
    """
    short = [name if len(name) <= NAME_LENGTH else f"{name[: NAME_LENGTH - 1]}…" for name in names]
    if len(names) < NUMBERED:
        return short
    return [f"{number} {name}" for number, name in enumerate(short, start=1)]

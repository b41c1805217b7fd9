"""Functions of the Python interface that read logs, and convert them to arrays and tables."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tetractl.core.clock import MILLISECOND
from tetractl.core.errors import UsageError, require_type
from tetractl.core.poses import Bools, Floats
from tetractl.log.read.trial_log import TrialLog

if TYPE_CHECKING:
    import pandas

    from tetractl.statistics.open_batch import Batch

Strings = NDArray[np.str_]

Trial = TrialLog | str | Path
"""A trial, or its log."""


def read_log(path: str | Path) -> TrialLog:
    """Read a trial from its log.

    If the log is damaged, the intact part is read, and the trial's `damage` describes what is
    missing.

    Args:
        path: The log, a file such as trial-000.mcap.

    Raises:
        LogError: If nothing can be read.

    Example:
        >>> trial = tetractl.read_log("logs/cell/trial-000.mcap")
        >>> f"{trial.result.duration_s:.1f} s"
        '7.6 s'
    """
    from tetractl.log.read.reader import read_trial

    require_type(path, str | Path, "read_log needs the file of a log")
    return read_trial(Path(path))


def read_batch(*paths: str | Path) -> "Batch":
    """Read the results of many trials, at about a millisecond per log.

    Args:
        *paths: Logs, folders of logs, or patterns such as "logs/cell/trial-00*.mcap".

    Returns:
        A batch. It has the `trials`, the earlier `attempts` at them, and the `damaged` logs.

    Raises:
        UsageError: If a path holds no trial.

    Example:
        >>> batch = tetractl.read_batch("logs/cell")
        >>> [trial.outcome.value for trial in batch.trials]
        ['arrived', 'arrived', 'arrived']
    """
    from tetractl.statistics.open_batch import open_batch

    if not paths:
        raise UsageError("no log is given")
    for path in paths:
        require_type(path, str | Path, "read_batch needs logs, folders or patterns of file names")
    return open_batch(paths)


def as_trial(trial: Trial) -> TrialLog:
    """Read the log of a trial that is given as its file. A `TrialLog` is returned unchanged."""
    if isinstance(trial, TrialLog):
        return trial
    require_type(
        trial, str | Path, "a trial must be the file of a log, or a value that read_log returns"
    )
    return read_log(trial)


def as_batch(batch: "Batch | str | Path | Sequence[str | Path]") -> "Batch":
    """Read a batch that is given as a folder or as paths of logs. A batch is returned unchanged."""
    from tetractl.statistics.open_batch import Batch

    if isinstance(batch, Batch):
        return batch
    if isinstance(batch, str | Path):
        return read_batch(batch)
    require_type(
        batch,
        Iterable,
        "a batch must be a folder, paths of logs or a value that read_batch returns",
    )
    return read_batch(*batch)


def as_trials(data: "Trial | Sequence[Trial] | Batch") -> list[TrialLog]:
    """Return the logs of the trials that are given as one trial, several, a batch, or a folder.

    Trials of a batch come in the batch's order. An empty list of trials is a `UsageError`.
    """
    from tetractl.statistics.open_batch import Batch

    if isinstance(data, str | Path) and Path(data).is_dir():
        data = read_batch(data)
    if isinstance(data, Batch):
        return [read_log(trial.log) for trial in data.trials]
    if isinstance(data, TrialLog | str | Path):
        return [as_trial(data)]
    require_type(
        data, Iterable, "give a trial, a list of trials, a batch or its statistics to draw"
    )
    trials = [as_trial(trial) for trial in data]
    if not trials:
        raise UsageError("the list of trials to draw is empty")
    return trials


@dataclass(frozen=True, slots=True, eq=False)
class TrialArrays:
    """A trial of M camera frames, K control steps and N robots, as arrays.

    Times count from the first direction that was sent.

    Attributes:
        unit: Length unit of the spec, such as "mm". Poses and distances use it.
        robots: Names of the robots, shape (N,).
        time_s: When each frame was exposed [s], shape (M,).
        frame: Number of each frame, shape (M,).
        poses: Measured poses, shape (M, N, 3): x and y [length unit], heading [rad].
        valid: Whether each robot was tracked, shape (M, N).
        truth: True poses, like `poses`. NaN if they are not known, as in a lab.
        distance: Distance from the measured position to the target [length unit], shape (M, N).
        step_time_s: When each command was sent [s], shape (K,).
        direction: The common direction u [rad], shape (K,). NaN while the field is off.
        cost: Cost J of the chosen sequence, equation (7) of the paper, shape (K,).
        length: Number of signals in the chosen sequence, shape (K,).
        evaluations: Number of costs evaluated, shape (K,).
        solve_ms: Wall time of the search [ms], shape (K,).
    """

    unit: str
    robots: Strings
    time_s: Floats = field(repr=False)
    frame: NDArray[np.int64] = field(repr=False)
    poses: Floats = field(repr=False)
    valid: Bools = field(repr=False)
    truth: Floats = field(repr=False)
    distance: Floats = field(repr=False)
    step_time_s: Floats = field(repr=False)
    direction: Floats = field(repr=False)
    cost: Floats = field(repr=False)
    length: NDArray[np.int64] = field(repr=False)
    evaluations: NDArray[np.int64] = field(repr=False)
    solve_ms: Floats = field(repr=False)


def to_arrays(trial: Trial) -> TrialArrays:
    """Convert a trial's poses, commands and decisions to NumPy arrays.

    Args:
        trial: A trial, or its log.

    Example:
        >>> arrays = tetractl.to_arrays("logs/cell/trial-000.mcap")
        >>> arrays.poses.shape  # camera frames, robots, (x, y, heading)
        (915, 1, 3)
    """
    trial = as_trial(trial)
    setup = trial.start.setup
    steps = trial.steps
    unknown = np.full_like(trial.mocap, np.nan)
    return TrialArrays(
        unit=setup.unit,
        robots=np.array(setup.names),
        time_s=trial.frames_s,
        frame=trial.frames,
        poses=trial.mocap,
        valid=trial.valid,
        truth=unknown if trial.truth is None else trial.truth,
        distance=setup.distances(trial.mocap[..., :2]),
        step_time_s=trial.steps_s,
        direction=np.array([step.plan.direction for step in steps], dtype=float),
        cost=np.array([step.plan.cost for step in steps], dtype=float),
        length=np.array([len(step.plan.signals) for step in steps], dtype=np.int64),
        evaluations=np.array([step.plan.evaluations for step in steps], dtype=np.int64),
        solve_ms=np.array([step.solve_ns for step in steps], dtype=float) / MILLISECOND,
    )


def to_dataframe(data: "TrialLog | Batch | str | Path") -> "pandas.DataFrame":
    """Convert a trial or a batch to a pandas DataFrame.

    The columns are those of the tables `poses` and `trials` that `tetractl export` writes.

    Args:
        data: A trial or its log, or a batch or its folder.

    Returns:
        For a trial, one row for each frame and robot. `attrs["origin"]` names the plant, such as
        "emulated lab". For a batch, one row for each trial. The column `origin` names the plant,
        and `attempt` is True for earlier attempts at a trial.

    Raises:
        UsageError: If pandas is not installed.

    Example:
        >>> table = tetractl.to_dataframe("logs/cell")
        >>> len(table)
        3
    """
    try:
        import pandas
    except ModuleNotFoundError:
        raise UsageError(
            "a DataFrame needs pandas, which is not installed",
            "install it with: pip install pandas; or use to_arrays instead",
        ) from None
    from tetractl.statistics.trial_tables import poses, trials_table

    if isinstance(data, str | Path):
        is_folder = Path(data).is_dir()
        data = read_batch(data) if is_folder else read_log(data)
    if not isinstance(data, TrialLog):
        rows = trials_table(as_batch(data))
        return pandas.DataFrame(rows.as_dict())
    frame = pandas.DataFrame(poses(data).as_dict())
    frame.attrs["origin"] = data.origin.value
    return frame

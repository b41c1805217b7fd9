"""Read the results of a batch of trials from their logs, and decide which trials count."""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from glob import has_magic
from pathlib import Path
from typing import Any

from tetractl.core.errors import LogError, UsageError
from tetractl.core.shown import NotebookDisplay
from tetractl.log.read.find import find_logs, is_set_aside, without_other_files
from tetractl.log.read.reader import read_result
from tetractl.log.read.trial_log import ResultSummary
from tetractl.spec.experiment import FIELDS_WITHOUT_EFFECT, Experiment
from tetractl.tools.table.table import join_listed

OnLog = Callable[[int, int], object]
"""A function that is called with the number of logs read so far, and the number of all logs."""


@dataclass(frozen=True, slots=True)
class Damaged:
    """A log whose trial cannot be read.

    Attributes:
        log: Path of the log.
        problem: Why the trial cannot be read.
    """

    log: str
    problem: str

    @property
    def set_aside(self) -> bool:
        """Whether `--resume` has set the log aside, as an earlier attempt at a trial."""
        return is_set_aside(Path(self.log).name)


@dataclass(frozen=True, slots=True)
class Batch(NotebookDisplay):
    """A batch: trials of one experiment, read from their logs.

    Attributes:
        trials: The results of the trials.
        attempts: The results of earlier attempts at the same trials. Either `--resume` has set
            their logs aside, or they are incomplete and a complete log of the trial exists.
        damaged: Logs whose trial cannot be read, including attempts.
    """

    trials: tuple[ResultSummary, ...]
    attempts: tuple[ResultSummary, ...] = ()
    damaged: tuple[Damaged, ...] = ()

    def __repr__(self) -> str:
        counts = {
            "trials": len(self.trials),
            "attempts": len(self.attempts),
            "damaged": len(self.damaged),
        }
        return f"Batch({', '.join(f'{count} {name}' for name, count in counts.items() if count)})"

    @classmethod
    def from_results(
        cls, results: Iterable[ResultSummary], damaged: Iterable[Damaged] = ()
    ) -> "Batch":
        """Create a batch from results of trials, with earlier attempts separated.

        A result is an attempt if its log was set aside, or if it is incomplete and another result
        of the same trial is complete. The order of the results is kept.
        """
        results = list(results)
        complete = {_trial_key(trial) for trial in results if trial.outcome.complete}
        trials: list[ResultSummary] = []
        attempts: list[ResultSummary] = []
        for trial in results:
            replaced = not trial.outcome.complete and _trial_key(trial) in complete
            if replaced or is_set_aside(Path(trial.log).name):
                attempts.append(trial)
            else:
                trials.append(trial)
        return cls(
            trials=tuple(trials),
            attempts=tuple(attempts),
            damaged=tuple(damaged),
        )

    @property
    def logs(self) -> list[Path]:
        """The paths of the logs, one for each trial. Attempts and unreadable logs are left out."""
        return [Path(trial.log) for trial in self.trials]

    @property
    def lost(self) -> tuple[Damaged, ...]:
        """The unreadable logs whose trials are missing in the batch. Attempts are left out."""
        return tuple(log for log in self.damaged if not log.set_aside)

    @property
    def lost_attempts(self) -> tuple[Damaged, ...]:
        """The earlier attempts at trials whose logs cannot be read."""
        return tuple(log for log in self.damaged if log.set_aside)

    @property
    def whole(self) -> bool:
        """Whether all logs of the batch are intact. Attempts are ignored.

        A log that was read although it is damaged is not intact.
        """
        return not self.lost and not any(trial.recovered for trial in self.trials)


class Batches(NotebookDisplay, dict[str, Batch]):
    """Several batches by name, such as the arms of a study."""


def _trial_key(trial: ResultSummary) -> tuple[int, int]:
    return trial.seed, trial.trial


def is_counted(trial: ResultSummary) -> bool:
    """Check whether a trial counts in the means: its errors are known, and its log is intact.

    The errors are known if the trial is complete and all errors are finite.
    """
    return errors_known(trial) and not trial.recovered


def errors_known(trial: ResultSummary) -> bool:
    """Check whether a trial is complete, and its total error and all robots' errors are finite."""
    errors = (trial.result.total_error, *trial.result.robot_errors)
    return trial.outcome.complete and all(map(math.isfinite, errors))


@dataclass(frozen=True, slots=True)
class Source:
    """The logs of a batch, before their results are read.

    Attributes:
        name: Name of the batch.
        logs: Paths of the logs.
    """

    name: str
    logs: Sequence[Path]

    @classmethod
    def from_paths(cls, paths: Sequence[Path | str]) -> "Source":
        """Find the logs in files, folders and patterns, including earlier attempts.

        The batch gets the name of the first path, with the number of further paths.

        Raises UsageError for a path without a trial.
        """
        places = [Path(path) for path in paths]
        logs = find_logs(places, attempts=True)
        first_path = str(paths[0])
        name = first_path if has_magic(first_path) else places[0].resolve().name
        if len(paths) > 1:
            name += f" and {len(paths) - 1} more"
        return cls(name, logs)

    def read(self, on_log: OnLog = lambda done, count: None) -> Batch:
        """Read every result. A log that cannot be read is listed in the batch as damaged.

        `on_log` is called after each log with the number of logs read and the number of all logs.
        """
        trials: list[ResultSummary] = []
        damaged: list[Damaged] = []
        for read_count, log in enumerate(self.logs, start=1):
            try:
                trials.append(read_result(log))
            except LogError as error:
                problem = error.message.removeprefix(f"{log}: ")
                damaged.append(Damaged(str(log), problem))
            on_log(read_count, len(self.logs))
        return Batch.from_results(trials, damaged)


def open_batch(paths: Sequence[Path | str]) -> Batch:
    """Read the results of the logs in files, folders and patterns, including earlier attempts.

    A log that cannot be read is listed in the batch as damaged.

    Raises:
        UsageError: If a path holds no trial.
    """
    return Source.from_paths(paths).read()


def find_batches(path: Path | str) -> list[Source]:
    """Find the batches in a file, a folder or a pattern.

    Usually, the result is one batch. If the path is a folder whose logs are all in subfolders, such
    as a study, each subfolder is a batch.
    """
    source = Source.from_paths([path])
    by_arm: dict[Path, list[Path]] = {}
    for log in source.logs:
        by_arm.setdefault(log.parent, []).append(log)
    if len(by_arm) < 2 or any(arm.parent != Path(path) for arm in by_arm):
        return [source]
    return [Source(arm.name, logs) for arm, logs in by_arm.items()]


def combine_sources(paths: Sequence[Path | str]) -> Source:
    """Combine the logs in all paths into one batch.

    Raises:
        UsageError: If a path is a folder of several batches.
    """
    source = Source.from_paths(paths)
    for folder in filter(Path.is_dir, map(Path, paths)):
        batches = len(find_batches(folder))
        if batches > 1:
            raise UsageError(
                f"{folder}: this folder holds {batches} batches", "name the folder of each batch"
            )
    return source


def find_sources(paths: Sequence[str]) -> list[Source]:
    """Find the batches in the paths that a user has named.

    A single path gives the batches in it. If all paths are folders, each is a batch. Otherwise, all
    paths together form one batch.
    """
    listed = without_other_files(paths)
    if len(listed) == 1:
        return find_batches(listed[0])
    if not all(map(Path.is_dir, listed)):
        return [combine_sources(listed)]
    batches = [combine_sources([folder]) for folder in listed]
    if len({source.name for source in batches}) == len(batches):
        return batches
    return [Source(str(path), source.logs) for path, source in zip(listed, batches, strict=True)]


def shared_experiment(batch: Batch) -> Experiment:
    """Return the experiment that all trials and attempts of a batch share.

    Raises:
        UsageError: If there is no trial, if the experiments or the plants differ, or if a trial
            occurs twice, because copies of a log would count as independent trials.
        LogError: If no log can be read.
    """
    if not batch.trials:
        if batch.attempts:
            raise UsageError(
                "all of these logs are earlier attempts",
                "run the rest of the batch with --resume",
                "run the rest of the batch with resume=True",
            )
        if batch.lost:
            raise LogError("no log can be read: {0.log}: {0.problem}".format(batch.lost[0]))
        raise UsageError("there is no trial to summarise")
    first_trial = batch.trials[0]
    for trial in (*batch.trials, *batch.attempts):
        _check_same_experiment(first_trial, trial)
    _refuse_copies(batch.trials)
    return first_trial.experiment


def _check_same_experiment(first: ResultSummary, second: ResultSummary) -> None:
    """Raise UsageError if two trials come from different kinds of plants or experiments."""
    if second.origin is not first.origin:
        raise UsageError(
            f"{first.log} comes from the {first.origin}, but {second.log} from the {second.origin}",
            "give logs from only one plant, and the others with --against",
            "give logs from only one plant, and the others with compare()",
        )
    if second.experiment is first.experiment:
        return
    fields = differences(first.experiment, second.experiment)
    if fields:
        raise UsageError(
            f"{first.log} and {second.log} are from different experiments: {join_listed(fields)}",
            "give logs from only one batch, and the other batch with --against",
            "give logs from only one batch, and the other batch with compare()",
        )


def _refuse_copies(trials: Iterable[ResultSummary]) -> None:
    """Raise UsageError if a trial occurs twice.

    Two simulated trials are the same if their experiment's seed and number are equal. Two trials of
    a lab are the same only if their logs have the same content.
    """
    trials_by_key: dict[object, ResultSummary] = {}
    for trial in trials:
        # Two trials in the lab may have the same number and seed, and are different trials.
        key = _trial_key(trial) if trial.simulated else trial.digest or id(trial)
        earlier = trials_by_key.setdefault(key, trial)
        if earlier is not trial:
            raise UsageError(
                f"{earlier.log} and {trial.log} contain the same trial (seed {trial.seed}, "
                f"trial {trial.trial})",
                "give each trial only once, for instance by naming only one of the two folders",
            )


def differences(first: Experiment, second: Experiment) -> list[str]:
    """Describe the fields in which two experiments differ, as `controller.horizon_max: 20 != 30`.

    If the value is a section, or a list that differs in length, only the field's path is given.
    Fields that change no trial are left out. So are the robots, if both trials chose them by the
    same rule, and given directions, because each trial has its own.
    """
    left_out: dict[str, Any] = dict.fromkeys(FIELDS_WITHOUT_EFFECT, True)
    if first.chosen is not None and first.stated_robots == second.stated_robots:
        left_out["robots"] = True
        left_out["chosen"] = True
    if first.gives_directions and second.gives_directions:
        left_out["controller"] = {"directions"}
    first_fields = first.model_dump(mode="json", exclude=left_out)
    second_fields = second.model_dump(mode="json", exclude=left_out)
    return list(_differences(first_fields, second_fields))


def _differences(first: Any, second: Any, path: str = "") -> Iterator[str]:
    """Yield each field in which two values at a path of a spec differ, as "PATH: OURS != THEIRS".

    If lists or mappings cannot be compared entry by entry, only the path is yielded.
    """
    if first == second:
        return
    both_lists = isinstance(first, list) and isinstance(second, list)
    if isinstance(first, dict) and isinstance(second, dict):
        for key in first | second:
            inner = f"{path}.{key}" if path else key
            yield from _differences(first.get(key), second.get(key), inner)
    elif both_lists and len(first) == len(second):
        for i, (first_item, second_item) in enumerate(zip(first, second, strict=True)):
            yield from _differences(first_item, second_item, f"{path}.{i}")
    elif isinstance(first, dict | list) or isinstance(second, dict | list):
        yield path
    else:
        yield f"{path}: {_as_text(first)} != {_as_text(second)}"


def _as_text(value: Any) -> str:
    """Format a single value as in JSON, but a string without quotes."""
    return value if isinstance(value, str) else json.dumps(value)

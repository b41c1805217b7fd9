"""Opens batches: reads each trial's result once, from its log."""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tetractl.core.errors import LogError, UsageError
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.section_abilities import GivenDirections
from tetractl.log.read.find import find_logs, is_set_aside, without_others
from tetractl.log.read.reader import read_result
from tetractl.log.read.trial_log import ResultSummary

OnLog = Callable[[int, int], object]


@dataclass(frozen=True, slots=True)
class Damaged:
    """A log without a readable trial: its path, and what is wrong."""

    log: str
    problem: str

    @property
    def set_aside(self) -> bool:
        """Whether the log is an attempt that was set aside."""
        return is_set_aside(Path(self.log).name)


@dataclass(frozen=True, slots=True)
class Batch:
    """Trials that form one batch.

    `attempts` are earlier logs of the same trials: set aside by `--resume`, or incomplete while a
    complete log of the trial exists. `damaged` are logs without a readable trial, including
    attempts.
    """

    trials: tuple[ResultSummary, ...]
    attempts: tuple[ResultSummary, ...] = ()
    damaged: tuple[Damaged, ...] = ()

    def __repr__(self) -> str:
        counts = (self.trials, "trials"), (self.attempts, "attempts"), (self.damaged, "damaged")
        return f"Batch({', '.join(f'{len(these)} {what}' for these, what in counts if these)})"

    @classmethod
    def of(cls, found: Iterable[ResultSummary], damaged: Iterable[Damaged] = ()) -> "Batch":
        """Return the trials as a batch, with earlier attempts separated."""
        found = list(found)
        done = {_key(trial) for trial in found if trial.outcome.complete}
        trials: list[ResultSummary] = []
        attempts: list[ResultSummary] = []
        for trial in found:
            replaced = not trial.outcome.complete and _key(trial) in done
            aside = replaced or is_set_aside(Path(trial.log).name)
            (attempts if aside else trials).append(trial)
        return cls(tuple(trials), tuple(attempts), tuple(damaged))

    @property
    def logs(self) -> list[Path]:
        """The paths of the trials whose logs are whole."""
        return [Path(trial.log) for trial in self.trials if not trial.brief]

    @property
    def lost(self) -> tuple[Damaged, ...]:
        """Damaged logs, whose trials are missing in the batch."""
        return tuple(log for log in self.damaged if not log.set_aside)

    @property
    def lost_attempts(self) -> tuple[Damaged, ...]:
        """Attempts that cannot be read."""
        return tuple(log for log in self.damaged if log.set_aside)

    @property
    def whole(self) -> bool:
        """Whether no log of the batch is damaged; attempts are ignored."""
        return not self.lost and not any(trial.recovered for trial in self.trials)


def _key(trial: ResultSummary) -> tuple[int, int]:
    return trial.seed, trial.trial


def counts(trial: ResultSummary) -> bool:
    """Whether a trial's errors enter the means: it is complete and its errors are known."""
    errors = (trial.result.total_error, *trial.result.robot_errors)
    return trial.outcome.complete and all(map(math.isfinite, errors))


@dataclass(frozen=True, slots=True)
class Source:
    """The logs of a batch that is called `name`."""

    name: str
    logs: Sequence[Path]

    @classmethod
    def of(cls, paths: Sequence[Path | str]) -> "Source":
        """Return the logs that files, folders and patterns name, including earlier attempts.

        Raises UsageError for a path without a trial.
        """
        places = [Path(path) for path in paths]
        logs = find_logs(places, attempts=True)
        more = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
        name = str(paths[0]) if any(c in str(paths[0]) for c in "*?[") else places[0].resolve().name
        return cls(name + more, logs)

    def by_arm(self, folder: Path) -> "list[Source]":
        """Return a source per folder in `folder` if all trials are in several of these, such as the
        arms of a study, otherwise this source.
        """
        logs: dict[Path, list[Path]] = {}
        for log in self.logs:
            logs.setdefault(log.parent, []).append(log)
        if len(logs) < 2 or any(arm.parent != folder for arm in logs):
            return [self]
        return [Source(arm.name, found) for arm, found in logs.items()]

    def read(self, on_log: OnLog = lambda done, count: None) -> Batch:
        """Read every result; `on_log` is called with the numbers of logs read and of all logs."""
        trials: list[ResultSummary] = []
        damaged: list[Damaged] = []
        for done, log in enumerate(self.logs, start=1):
            try:
                trials.append(read_result(log))
            except LogError as error:
                damaged.append(Damaged(str(log), error.message.removeprefix(f"{log}: ")))
            on_log(done, len(self.logs))
        return Batch.of(trials, damaged)


def open_batch(paths: Sequence[Path | str]) -> Batch:
    """Read the results of the logs in files, folders and patterns; UsageError for a path without a
    trial."""
    return Source.of(paths).read()


def sources(paths: Sequence[str]) -> list[Source]:
    """Return the files of each batch: of each folder, if the paths are several folders; of each
    folder in it, if the only path is a folder of folders, such as a study's; otherwise of all paths
    together.
    """
    paths = [str(path) for path in without_others(paths)]
    if len(paths) > 1 and all(Path(path).is_dir() for path in paths):
        found = [one_source([path]) for path in paths]
        if len({source.name for source in found}) < len(found):
            found = [Source(path, s.logs) for path, s in zip(paths, found, strict=True)]
        return found
    return Source.of(paths).by_arm(Path(paths[0])) if len(paths) == 1 else [one_source(paths)]


def one_source(paths: Sequence[str]) -> Source:
    """Return the files of all paths as one batch; UsageError if a path is a folder of
    several batches.
    """
    source = Source.of(paths)
    for folder in filter(Path.is_dir, map(Path, paths)):
        listed = source if len(paths) == 1 else Source.of([folder])
        if (count := len(listed.by_arm(folder))) > 1:
            raise UsageError(f"{folder}: holds {count} batches", "name the folder of each")
    return source


_BOOKKEEPING = {"trials", "description", "error_bound"}  # fields that do not change a trial


def experiment_of(batch: Batch) -> Experiment:
    """Return the experiment that all trials and attempts share.

    Raises UsageError if the experiments or the plants differ, or if a trial occurs twice: copies of
    a log, or a simulation run again, would count as independent trials.
    """
    if not batch.trials:
        if batch.attempts:
            raise UsageError("all logs are earlier attempts", "complete the batch with --resume")
        if batch.lost:
            raise LogError("no log can be read: {0.log}: {0.problem}".format(batch.lost[0]))
        raise UsageError("no trial to summarise")
    first = batch.trials[0]
    for other in (*batch.trials, *batch.attempts):
        if other.origin is not first.origin:
            raise UsageError(
                f"{first.log} is from the {first.origin}, {other.log} from the {other.origin}",
                "give the logs of one plant, and the others with --against",
            )
        if other.experiment is first.experiment:
            continue
        if found := differences(first.experiment, other.experiment):
            raise UsageError(
                f"{first.log} and {other.log} have different experiments: {listing(found)}",
                "give the logs of one batch, and the other batch with --against",
            )
    _refuse_copies(batch.trials)
    return first.experiment


def _refuse_copies(trials: Iterable[ResultSummary]) -> None:
    seen: dict[object, ResultSummary] = {}
    for trial in trials:
        # Two trials in the lab may have the same number and seed, and are different trials.
        key = (trial.seed, trial.trial) if trial.simulated else trial.digest or id(trial)
        twin = seen.setdefault(key, trial)
        if twin is not trial:
            raise UsageError(
                f"{twin.log} and {trial.log} are the same trial"
                f" (seed {trial.seed}, trial {trial.trial})",
                "give each trial once, for instance by naming one of the two folders",
            )


def differences(one: Experiment, two: Experiment) -> list[str]:
    """Return a text such as `controller.horizon_max: 20 != 30` for each field in which two
    experiments differ; only the field's path if its value is a section, or a list that differs in
    length.

    Fields that do not change a trial are left out: the description, the number and seed of the
    trials, and the error bound; also the robots, if both trials chose them by the same rule, and
    directions that are given: each trial has its own.
    """
    left_out: dict[str, Any] = dict.fromkeys(_BOOKKEEPING, True)
    if one.chosen is not None and one.asked == two.asked:
        left_out |= {"robots": True, "chosen": True}
    if directions_given(one) and directions_given(two):
        left_out["controller"] = {"directions"}
    ours, theirs = (each.model_dump(mode="json", exclude=left_out) for each in (one, two))
    return list(_differences(ours, theirs))


def directions_given(experiment: Experiment) -> bool:
    """Return whether no controller decided: the spec gives the directions. Its errors may come from
    hindsight, so they are no controller's."""
    return isinstance(experiment.controller, GivenDirections)


def _differences(one: Any, two: Any, path: str = "") -> Iterator[str]:
    if one == two:
        return
    if isinstance(one, dict) and isinstance(two, dict):
        for key in one | two:
            yield from _differences(one.get(key), two.get(key), f"{path}.{key}" if path else key)
    elif isinstance(one, list) and isinstance(two, list) and len(one) == len(two):
        for index, (left, right) in enumerate(zip(one, two, strict=True)):
            yield from _differences(left, right, f"{path}.{index}")
    elif isinstance(one, (dict, list)) or isinstance(two, (dict, list)):
        yield path
    else:
        words = (value if isinstance(value, str) else json.dumps(value) for value in (one, two))
        yield f"{path}: {' != '.join(words)}"


def listing(texts: Sequence[str], between: str = ", ") -> str:
    """Join the first four texts into one line, with the number of the rest."""
    more = len(texts) - 4
    return between.join(texts[:4]) + (f" and {more} more" if more > 0 else "")

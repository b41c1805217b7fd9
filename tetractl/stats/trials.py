"""The trials of a batch: one result each, all of the same experiment."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from tetractl.core.errors import LogError, UsageError
from tetractl.experiment.experiment import Experiment
from tetractl.log.read.find import find_logs, find_rows, is_set_aside
from tetractl.log.read.reader import read_result
from tetractl.log.read.trial_log import ResultSummary
from tetractl.stats.damaged import Damaged
from tetractl.stats.unlogged import add_unlogged

_BOOKKEEPING = {"trials", "description"}  # fields that do not change a trial


def load_trials(
    paths: Iterable[Path | str],
    on_log: Callable[[int, int], object] = lambda done, count: None,
    rows: bool = False,
) -> tuple[list[ResultSummary], list[Damaged]]:
    """Read the results of the logs in files, folders and patterns, those set aside too.

    With `rows`, trials of a study that have no log in their folder are read from its rows. `on_log`
    is called after each log with the numbers of logs read and of all. Raises UsageError for a path
    without a trial.
    """
    trials: list[ResultSummary] = []
    damaged: list[Damaged] = []
    paths = [Path(path) for path in paths]
    kept = {path: found for path in paths if (found := find_rows(path))} if rows else {}
    logs = find_logs(paths, attempts=True, bare=kept)
    for done, log in enumerate(logs, start=1):
        try:
            trials.append(read_result(log))
        except LogError as error:
            damaged.append(Damaged(str(log), str(error).removeprefix(f"{log}: ")))
        on_log(done, len(logs))
    add_unlogged((file for found in kept.values() for file in found), trials, damaged)
    return trials, damaged


def split_attempts(
    trials: Sequence[ResultSummary],
) -> tuple[list[ResultSummary], list[ResultSummary]]:
    """Return the trials, and the earlier attempts at them, both in order.

    An attempt is a log that `--resume` set aside, or one that did not run to its end, whatever it
    is called, of a trial that has a complete log besides.
    """
    done = {_key(trial) for trial in trials if trial.outcome.complete}
    split: tuple[list[ResultSummary], list[ResultSummary]] = ([], [])
    for trial in trials:
        replaced = not trial.outcome.complete and _key(trial) in done
        split[replaced or is_set_aside(Path(trial.path).name)].append(trial)
    return split


def _key(trial: ResultSummary) -> tuple[int, int]:
    return trial.seed, trial.trial


def counts(trial: ResultSummary) -> bool:
    """Whether a trial's errors enter the means: it is complete and its errors are known."""
    errors = (trial.result.total_error, *trial.result.robot_errors)
    return trial.outcome.complete and all(map(math.isfinite, errors))


def one_batch(
    trials: Sequence[ResultSummary], attempts: Sequence[ResultSummary] = ()
) -> Experiment:
    """Return the experiment that all trials and attempts share.

    Raises UsageError where they do not share one, where some are of an emulated lab and some are
    not, or where a trial occurs twice: copies of a log, or a simulation run again, would make n
    larger than it is.
    """
    if not trials:
        if attempts:
            raise UsageError("no trial to summarise but earlier attempts", "go on with --resume")
        raise UsageError("no trial to summarise")
    first = trials[0]
    for other in (*trials, *attempts):
        if other.origin is not first.origin:
            raise UsageError(
                f"{first.path} is of the {first.origin}, {other.path} of the {other.origin}",
                "give the logs of one, and the others with --against",
            )
        if other.experiment is first.experiment:
            continue
        if found := differences(first.experiment, other.experiment):
            raise UsageError(
                f"{first.path} and {other.path} are not the same experiment: {listing(found)}",
                "give the logs of one batch, and the other batch with --against",
            )
    _refuse_copies(trials)
    return first.experiment


def _refuse_copies(trials: Iterable[ResultSummary]) -> None:
    seen: dict[object, ResultSummary] = {}
    for trial in trials:
        # A trial in the lab is done again under the same number and seed, and is then another one.
        key = (trial.seed, trial.trial) if trial.simulated else trial.digest or id(trial)
        twin = seen.setdefault(key, trial)
        if twin is not trial:
            raise UsageError(
                f"{twin.path} and {trial.path} are the same trial"
                f" (seed {trial.seed}, trial {trial.trial})",
                "give each trial once, for instance by naming one of the two folders",
            )


def differences(one: Experiment, two: Experiment) -> list[str]:
    """Return `path: value != value` for each field in which two experiments differ.

    The description and the trials' count and seed are left out: they do not change a trial.
    """
    return list(
        _differences(
            one.model_dump(mode="json", exclude=_BOOKKEEPING),
            two.model_dump(mode="json", exclude=_BOOKKEEPING),
        )
    )


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
        yield f"{path}: {one} != {two}"


def listing(differences: Sequence[str], most: int = 4) -> str:
    """Join the first few differences into one line."""
    more = len(differences) - most
    return ", ".join(differences[:most]) + (f" and {more} more" if more > 0 else "")

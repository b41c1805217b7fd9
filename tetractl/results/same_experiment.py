"""Whether trials are of one experiment, and in which fields two experiments differ."""

import json
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from tetractl.core.errors import LogError, UsageError
from tetractl.experiment.experiment import Experiment
from tetractl.log.read.trial_log import ResultSummary
from tetractl.results.batch import Batch

_BOOKKEEPING = {"trials", "description", "error_bound"}  # fields that do not change a trial


def experiment_of(batch: Batch) -> Experiment:
    """Return the experiment that all trials and attempts share.

    Raises UsageError where they do not share one, where some are of an emulated lab and some are
    not, or where a trial occurs twice: copies of a log, or a simulation run again, would make n
    larger than it is.
    """
    if not batch.trials:
        if batch.attempts:
            raise UsageError("no trial to summarise but earlier attempts", "go on with --resume")
        if batch.lost:
            raise LogError("no log can be read: {0.path}: {0.problem}".format(batch.lost[0]))
        raise UsageError("no trial to summarise")
    first = batch.trials[0]
    for other in (*batch.trials, *batch.attempts):
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
    _refuse_copies(batch.trials)
    return first.experiment


def _refuse_copies(trials: Iterable[ResultSummary]) -> None:
    seen: dict[object, ResultSummary] = {}
    for trial in trials:
        # A trial in the lab is repeated under the same number and seed, and is then another one.
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

    What does not change a trial is left out: the description, the trials' count and seed, and the
    bound of the tables.
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
        words = (value if isinstance(value, str) else json.dumps(value) for value in (one, two))
        yield f"{path}: {' != '.join(words)}"


def listing(differences: Sequence[str], most: int = 4) -> str:
    """Join the first few differences into one line."""
    more = len(differences) - most
    return ", ".join(differences[:most]) + (f" and {more} more" if more > 0 else "")

"""The trials of a batch: one result each, all of the same experiment."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Self

from tetractl.control.plan import Outcome
from tetractl.errors import UsageError
from tetractl.log.records import EPOCH_NS, Result, Start
from tetractl.spec.experiment import Experiment

COMPLETE = (Outcome.ARRIVED, Outcome.SEQUENCE_USED_UP, Outcome.STEPS_MAX)
"""Outcomes decided by the controller: only these trials ran to their end."""

_BOOKKEEPING = {"trials", "description"}  # do not change what a trial does


@dataclass(frozen=True, slots=True)
class Trial:
    """One trial as statistics see it.

    `seed` is the batch's root seed and `trial` the index in the batch; `start_unix_ns` is when the
    trial started, the same for all in simulation. `result` is None where the log ends before the
    trial did. `recovered` marks a damaged log whose readable part was used.
    """

    path: str
    experiment: Experiment
    seed: int
    trial: int
    result: Result | None
    recovered: bool = False
    start_unix_ns: int = EPOCH_NS

    @classmethod
    def of(cls, path: str, start: Start, result: Result | None, recovered: bool = False) -> Self:
        """Take a trial from what its log holds, or would hold."""
        seed = start.experiment.trials.seed
        return cls(
            path, start.experiment, seed, start.trial, result, recovered, start.start_unix_ns
        )

    @property
    def outcome(self) -> Outcome | None:
        """How the trial ended, None where its log does not say."""
        return self.result.outcome if self.result else None

    @property
    def counted(self) -> bool:
        """Whether the trial's errors enter the means: it is complete and its errors are known."""
        return (
            self.result is not None
            and self.result.outcome in COMPLETE
            and math.isfinite(self.result.total_error)
            and all(math.isfinite(error) for error in self.result.robot_errors)
        )


def one_batch(trials: Sequence[Trial]) -> Experiment:
    """Return the experiment that all trials share.

    Raises UsageError where they do not share one, or where a trial occurs twice, be it a copy of
    a log or a simulation run again: averaging copies would make n larger than it is.
    """
    if not trials:
        raise UsageError("no trial to summarise")
    first = trials[0]
    for other in trials:
        if other.experiment is first.experiment:
            continue
        if found := differences(first.experiment, other.experiment):
            raise UsageError(
                f"{first.path} and {other.path} are not the same experiment: {listing(found)}",
                "give the logs of one batch, and the other batch with --against",
            )
    _refuse_copies(trials)
    return first.experiment


def _refuse_copies(trials: Iterable[Trial]) -> None:
    seen: dict[tuple[int, int, int], Trial] = {}
    for trial in trials:
        twin = seen.setdefault((trial.seed, trial.trial, trial.start_unix_ns), trial)
        if twin is not trial:
            raise UsageError(
                f"{twin.path} and {trial.path} are the same trial"
                f" (seed {trial.seed}, trial {trial.trial})",
                "give each trial once, for instance by naming one of the two folders",
            )


def differences(one: Experiment, two: Experiment) -> list[str]:
    """Return `path: value != value` for each field in which two experiments differ.

    The trials' count and seed and the description are left out: they do not change what one trial
    does.
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

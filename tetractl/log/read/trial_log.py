"""What a log gives back: a whole trial, or only how it ended."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tetractl.core.commands import Command
from tetractl.core.plan import Outcome
from tetractl.core.poses import Floats
from tetractl.core.trial import Result, Start, Step
from tetractl.experiment.experiment import Experiment

Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Damage:
    """What is wrong with a log: `lost` says what is missing, in words for people."""

    problems: tuple[str, ...]
    lost: tuple[str, ...]


def _none() -> Integers:
    return np.empty(0, dtype=np.int64)


@dataclass(frozen=True, slots=True)
class TrialLog:
    """A whole trial, read back. Times are ns on the trial's clock.

    `mocap` and `truth` are (M, N, 3) poses at `mocap_ns` (M,), when the cameras were exposed, in
    the frames numbered `frames` (M,), which the host had at `received_ns` (M,); `valid` is (M, N).
    `commands` are all that were sent: those of the steps, those outside them, and the stop. `truth`
    is None for a lab trial and NaN where a damaged log lost it. `result` is None where the run
    crashed or the end of the log is lost. `digest` is the content digest that the log states.
    """

    path: str
    experiment: Experiment
    start: Start
    mocap_ns: Integers
    mocap: Floats
    valid: NDArray[np.bool_]
    truth: Floats | None
    steps: tuple[Step, ...]
    stop: Command | None
    result: Result | None
    damage: Damage | None
    host: dict[str, str]  # host facts: when and where it ran
    provenance: dict[str, str]
    frames: Integers = field(default_factory=_none)
    received_ns: Integers = field(default_factory=_none)
    commands: tuple[Command, ...] = ()
    digest: str | None = None


@dataclass(frozen=True, slots=True)
class ResultSummary:
    """The result of a trial without its course, read quickly.

    `recovered` says that the log is damaged or ends early: where its result is lost, `result` was
    computed again from the last poses there are, with the outcome `aborted`.
    """

    path: str
    experiment: Experiment
    seed: int  # the batch's root seed
    trial: int
    simulated: bool
    result: Result
    recovered: bool
    digest: str | None  # content digest, None where the result was lost

    @property
    def outcome(self) -> Outcome:
        """How the trial ended."""
        return self.result.outcome

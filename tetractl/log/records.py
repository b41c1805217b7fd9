"""What a trial's log holds: emitted by the trial loop, stored and given back by the log."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tetractl.control.plan import Outcome, Plan
from tetractl.model.state import Floats, Observation
from tetractl.plant.protocol import Command, Note, PlantInfo, Sample, Verdict
from tetractl.spec.experiment import Experiment

Integers = NDArray[np.int64]

FORMAT_VERSION = 1
EPOCH_NS = 1_577_836_800_000_000_000  # 2020-01-01 UTC: virtual trials start here, so logs repeat


@dataclass(frozen=True, slots=True)
class Start:
    """Everything known before the first step of a trial."""

    experiment: Experiment  # as resolved, with --set applied
    spec_text: str  # as written
    spec_name: str  # file name of the spec
    trial: int  # index in the batch, from 0
    plant: PlantInfo
    start_unix_ns: int  # trial clock 0 in Unix time; EPOCH_NS in simulation
    attached: tuple[tuple[str, str], ...] = ()  # name and text of files the spec draws on


@dataclass(frozen=True, slots=True)
class Step:
    """One control step k: what was seen, decided and sent.

    `solve_ns` and `deadline_missed` are host facts: they differ from run to run on the same seed.
    """

    k: int
    observation: Observation
    plan: Plan
    command: Command
    solve_ns: int
    deadline_missed: bool


@dataclass(frozen=True, slots=True)
class Result:
    """How a trial ended. Lengths are in the experiment's unit; errors are to the targets."""

    outcome: Outcome
    reason: str
    steps: int
    duration_s: float
    total_error: float
    robot_errors: tuple[float, ...]
    verdict: Verdict
    solve_ns: tuple[int, ...] = field(repr=False)  # host facts, one a step
    deadline_misses: int = 0  # host fact

    @property
    def entered_obstacle(self) -> bool:
        """Whether any robot was truly inside an obstacle."""
        return any(self.verdict.entered)


class Observer(Protocol):
    """Watches a trial: the log writer, the live view and the progress are observers."""

    def on_start(self, start: Start) -> None:
        """Before the first step."""
        ...

    def on_samples(self, samples: list[Sample]) -> None:
        """Camera frames, oldest first, each once."""
        ...

    def on_step(self, step: Step) -> None:
        """After each control step; `step.command` is not told again by `on_command`."""
        ...

    def on_command(self, command: Command) -> None:
        """A command sent outside the control steps, as in the square before the first plan."""
        ...

    def on_note(self, note: Note) -> None:
        """Something a person should know of, such as a robot that does not move as told."""
        ...

    def on_stop(self, stop: Command, result: Result) -> None:
        """After the robots were stopped, whatever the reason."""
        ...


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
    seed: int  # the batch's root seed
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

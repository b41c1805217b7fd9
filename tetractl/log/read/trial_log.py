"""The results of reading a log: a whole trial, or only its result."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import islice, pairwise

import numpy as np

from tetractl.core.clock import SECOND, seconds
from tetractl.core.commands import Command
from tetractl.core.motion_estimate import Estimate
from tetractl.core.plan import Outcome
from tetractl.core.poses import Floats
from tetractl.core.shown import NotebookDisplay
from tetractl.core.trial import (
    EMULATED_DEVICES_FACT,
    EMULATED_PLANT,
    PlantInfo,
    Result,
    TrialRecords,
)
from tetractl.log.format.derived_messages import outcome_from_log
from tetractl.spec.experiment import Experiment
from tetractl.spec.loaded_spec import LoadedSpec


class Origin(StrEnum):
    """Where a trial took place: in a simulation, in an emulated lab or in a real lab.

    Every table and figure states this.
    """

    UNDISTURBED = "undisturbed simulation"
    DISTURBED = "disturbed simulation"
    EMULATED = "emulated lab"
    LAB = "lab"

    @classmethod
    def from_spec(cls, experiment: Experiment, plant: PlantInfo) -> "Origin":
        """Determine where a trial took place from its spec and the facts about its plant.

        A lab is emulated if its spec says so or a device reported so, whatever its address is.
        """
        if plant.simulated:
            return cls.DISTURBED if experiment.plant.disturbed else cls.UNDISTURBED
        is_emulated = experiment.plant.type == EMULATED_PLANT or plant.facts.get(
            EMULATED_DEVICES_FACT
        )
        return cls.EMULATED if is_emulated else cls.LAB

    @property
    def simulated(self) -> bool:
        """Whether the trial is from a simulation, and not from a real or emulated lab."""
        return self in (Origin.DISTURBED, Origin.UNDISTURBED)

    @property
    def comparable(self) -> bool:
        """Whether results may be compared with published results from real robots.

        This is so only for trials in a real lab.
        """
        return self is Origin.LAB


@dataclass(frozen=True, slots=True)
class Damage:
    """The damage of a log that is not intact.

    Such a log is

        torn        some records of the file cannot be read
        recovered   the log was copied from a torn log, and lacks the lost records of that log
        unfinished  the log has no result, or a result that tetractl does not write

    Attributes:
        problems: The problems of the log, one sentence each.
        lost: Descriptions of lost records, one sentence each.
    """

    problems: tuple[str, ...]
    lost: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Event:
    """A message for the operator that was written during a trial, such as a warning.

    Attributes:
        time_s: Time since the first direction sent [s]. Negative before it.
        level: The level, as in a `Note`.
        text: The message.
    """

    time_s: float
    level: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialLog(TrialRecords, NotebookDisplay):
    """A whole trial, read from its log.

    Attributes:
        log: Path of the log's file.
        experiment: The experiment, from the spec in the log.
        stop: The last stop command. None if the log contains none.
        damage: What is missing in the log. None for an intact log.
        facts: Machine, time and versions of the run.
        digest: The content digest stored in the log. None if there is none.
        pictures: The camera's images, each with its time of exposure on the trial's clock [ns]
            and a JPEG file.
    """

    log: str
    experiment: Experiment = field(repr=False)
    stop: Command | None = field(repr=False)
    damage: Damage | None
    facts: dict[str, str] = field(repr=False)
    digest: str | None = None
    pictures: tuple[tuple[int, bytes], ...] = field(default=(), repr=False)

    @property
    def began_ns(self) -> int:
        """The time of the first direction on the trial's clock [ns].

        This time is 0 on every time axis that users see. In the lab the trial's clock starts
        earlier, while the robots are placed. If the first steps are lost, the time is computed
        from the control period; without directions it is 0.
        """
        direction_times_ns = (command.sent_ns for command in self.commands if not command.stops)
        begin_times_ns = [*islice(direction_times_ns, 1)]  # commands are in the order of sending
        if self.steps:
            first_step = self.steps[0]
            elapsed_ns = round(first_step.k * self.start.setup.period_s * SECOND)
            begin_times_ns.append(first_step.command.sent_ns - elapsed_ns)
        return max(min(begin_times_ns, default=0), 0)

    def elapsed_s(self, time_ns: int) -> float:
        """Convert a time on the trial's clock [ns] to the time since the first direction [s]."""
        return seconds(time_ns - self.began_ns)

    @property
    def frames_s(self) -> Floats:
        """The times of the camera frames' exposures since the first direction [s], shape (M,)."""
        return (self.mocap_ns - self.began_ns) / SECOND

    @property
    def steps_s(self) -> Floats:
        """The times of the control steps' commands since the first direction [s], shape (K,)."""
        sent_ns = np.array([step.command.sent_ns for step in self.steps], dtype=np.int64)
        return (sent_ns - self.began_ns) / SECOND

    @property
    def last_estimate(self) -> Estimate | None:
        """The controller's estimate of the motion in the last step.

        The value is None if the controller made no estimate.
        """
        return self.steps[-1].plan.estimate if self.steps else None

    @property
    def positions(self) -> Floats:
        """The measured positions [length unit], shape (M, N, 2).

        NaN where a robot was untracked.
        """
        return np.where(self.valid[..., None], self.mocap[..., :2], np.nan)

    @property
    def events(self) -> tuple[Event, ...]:
        """The operator messages in order of time, with hints on what to do next."""
        events = [
            Event(
                self.elapsed_s(note.t_ns),
                note.level,
                outcome_from_log(note.text) + _next_step(note.text),
            )
            for note in self.notes
        ]
        return tuple(sorted(events, key=lambda event: event.time_s))

    @property
    def origin(self) -> Origin:
        """The origin of the trial: simulation, emulated lab or lab."""
        return Origin.from_spec(self.experiment, self.start.plant)

    @property
    def spec(self) -> LoadedSpec:
        """The spec with which the trial can be run again."""
        start = self.start
        return LoadedSpec(
            self.experiment, start.spec_text, start.spec_name, attached=start.attached
        )


def _next_step(message: str) -> str:
    """Return a hint for the operator: the reason for a message, and the next step.

    Logs do not contain these hints. The result is empty if there is no hint.
    """
    if message.endswith(" is lost"):
        return (
            ": the camera sends no poses of this robot; check that it is switched on, and that the "
            "camera sees it (or, for robots on a mat, that it stands on the mat)"
        )
    if message.startswith("the model does not fit"):
        return (
            ": measure a, speed and dead time with `tetractl identify`, and the lag of the wheels "
            "with its option --wheels; the dead time is longer if frames are later than `latency`"
        )
    return ""


@dataclass(frozen=True, slots=True)
class ResultSummary(NotebookDisplay):
    """The result of a trial, read from its log without the frames and steps.

    Attributes:
        log: Path of the log's file.
        experiment: The experiment, from the spec in the log.
        seed: Root seed of the batch.
        trial: Index of the trial in the batch, from 0.
        origin: Where the trial took place.
        result: The result. A lost result is computed from the last poses of the log, with the
            outcome `aborted`.
        recovered: Whether the log is damaged or ends early.
        digest: The content digest stored in the log. None if there is none.
        warnings: Number of warnings and errors among the operator messages.
        code: Hash of the code that ran the trial (`provenance.trial_code`). Empty if unknown.
    """

    log: str
    experiment: Experiment = field(repr=False)
    seed: int
    trial: int
    origin: Origin
    result: Result
    recovered: bool
    digest: str | None
    warnings: int = 0
    code: str = ""

    @property
    def simulated(self) -> bool:
        """Whether the trial is from a simulation, and not from a real or emulated lab."""
        return self.origin.simulated

    @property
    def outcome(self) -> Outcome:
        """How the trial ended, for example by arrival or by an abort."""
        return self.result.outcome


@dataclass(frozen=True, slots=True)
class Gap:
    """A gap in the records of a log: control steps or camera frames are missing.

    Attributes:
        record_kind: Kind of the missing records, such as "camera frame".
        first_number: Number of the first missing record.
        last_number: Number of the last missing record.
        since_s: Beginning of the gap, since the first direction [s].
        until_s: End of the gap [s].
    """

    record_kind: str
    first_number: int
    last_number: int
    since_s: float
    until_s: float

    def __str__(self) -> str:
        numbers = (
            f"{self.first_number}"
            if self.first_number == self.last_number
            else f"{self.first_number} to {self.last_number}"
        )
        plural = "" if self.first_number == self.last_number else "s"
        interval = f"between {self.since_s:.3f} and {self.until_s:.3f} s"
        return f"{self.record_kind}{plural} {numbers}, {interval}"


def _gaps(record_kind: str, numbers: Sequence[int], times_s: Sequence[float]) -> list[Gap]:
    neighbours = zip(pairwise(numbers), pairwise(times_s), strict=True)
    return [
        Gap(record_kind, previous + 1, following - 1, *span_s)
        for (previous, following), span_s in neighbours
        if following - previous > 1
    ]


def frame_gaps(log: TrialLog) -> list[Gap]:
    """Return the gaps in the numbers of a log's camera frames."""
    return _gaps("camera frame", log.frames.tolist(), log.frames_s.tolist())


def step_gaps(log: TrialLog) -> list[Gap]:
    """Return the gaps in the numbers of a log's control steps, also at its start and end."""
    step_numbers = [-1, *(step.k for step in log.steps)]
    times_s = [0.0, *log.steps_s.tolist()]
    if log.result and log.result.steps > step_numbers[-1] + 1:
        step_numbers.append(log.result.steps)
        times_s.append(log.result.duration_s)
    return _gaps("control step", step_numbers, times_s)

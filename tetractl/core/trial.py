"""The records of a trial: its plant, its start, each control step, its verdict and its result."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import compress
from typing import Self

import numpy as np

from tetractl.core.commands import Command
from tetractl.core.plan import Outcome, Plan
from tetractl.core.poses import Bools, Floats, Integers, Observation, Poses, Sample
from tetractl.core.setup import Setup
from tetractl.core.tour import TourMeasure

# time at which all simulated trials start, so that their logs can be reproduced: 2020-01-01 UTC
EPOCH_NS = 1_577_836_800_000_000_000

OWN_FILES = frozenset({"spec.yaml", "spec.resolved.yaml", "environment.json", "layout.json"})
"""Names of the files attached to every log, which no file named in a spec may have."""
HALTS = "halts"
"""The fact of a lab that says whether its robots stand still after a stop."""
EMULATED_PLANT = "emulated"
"""The type of the plant that emulates a lab in virtual time."""
EMULATED_DEVICES = "emulated"
"""The key of `PlantInfo.facts` whose value names the emulated devices."""
REAL_DEVICE = "real"
"""The key of `PlantInfo.facts` that names the real device of plant `emulated`, if there is one."""


@dataclass(frozen=True, slots=True)
class PlantInfo:
    """A description of an open plant: `kind` is its type, and the log's metadata hold its `facts`.

    The fact HALTS of a lab is "yes" if its robots stand still after a stop, otherwise "no". The
    fact EMULATED_DEVICES names the lab's devices that are not real, such as "camera".
    """

    kind: str
    simulated: bool
    camera_rate_hz: float
    facts: dict[str, str]

    @property
    def virtual(self) -> bool:
        """Whether trials run in virtual time: those of a simulation, or of plant `emulated` without
        a real device."""
        if self.kind == EMULATED_PLANT:
            return REAL_DEVICE not in self.facts
        return self.simulated


@dataclass(frozen=True, slots=True)
class Note:
    """A message for the operator with its time in the trial; `level` is "info", "warning",
    "error", or "debug" for one of the calls that led to an exception, which only the log has."""

    t_ns: int
    level: str
    text: str


@dataclass(frozen=True, slots=True)
class Verdict:
    """How a trial of N robots ended, from the plant's finest samples of their paths.

    `final` are the poses after the stop. `entered` (N,) is True for robots whose path touched an
    obstacle, by `model.path_check`; `clearance` (N,) is the least distance of each robot to an
    obstacle [length unit], negative inside, inf without obstacles. `not_at_rest` is a text on the
    robots that did not stand still after the stop, "" if all stood still; `unrest` names those that
    may still drive when the trial has ended. `edge` (N,) is the least
    distance of each robot to the edge of the arena, negative outside the arena, and `apart` (N,)
    the least distance of each robot to another robot, inf for a single robot; both are empty in
    older logs. All distances are measured from the robots' centres; the methods count bodies of a
    `radius` [length unit], by default the centres. In a lab with robots on wheels `turn` (N,)
    is the rate at which each robot turned by itself while it drove, and `turn_std` (N,) its
    standard error, inf if it is unknown [rad/s]; otherwise both are empty. `can_restart` is False
    if somebody has to touch a robot or a device before another trial can start. Logs lack it.
    """

    final: Poses
    entered: tuple[bool, ...]
    clearance: tuple[float, ...]
    not_at_rest: str = ""
    edge: tuple[float, ...] = ()
    apart: tuple[float, ...] = ()
    turn: tuple[float, ...] = ()
    turn_std: tuple[float, ...] = ()
    unrest: str = ""
    can_restart: bool = True

    @classmethod
    def unknown(cls, robots: int) -> Self:
        """Return the verdict on N robots of which the plant could not tell where they stopped."""
        nowhere = Poses.of(np.full((robots, 3), np.nan))
        return cls(nowhere, (False,) * robots, (math.inf,) * robots, can_restart=False)

    def in_obstacle(self, radius: float = 0.0) -> list[bool]:
        """Return which robots (N,) entered an obstacle."""
        return [
            entered or gap < radius
            for entered, gap in zip(self.entered, self.clearance, strict=True)
        ]

    def over_edge(self, radius: float = 0.0) -> list[bool]:
        """Return which robots (N,) left the arena; empty if the log does not record it."""
        return [edge < radius for edge in self.edge]

    def touched(self, radius: float = 0.0) -> list[bool]:
        """Return which robots (N,) touched another one; empty if the log does not record it."""
        return [apart < 2 * radius for apart in self.apart]


@dataclass(frozen=True, slots=True)
class Start:
    """The start of a trial.

    `resolved` is the spec as YAML with all fields, including defaults and `--set`; `spec_hash` is
    the SHA-256 of its values, as 64 hex digits. `packages` are name and version of the
    packages, other than tetractl, that provide a kind used by the spec.
    """

    setup: Setup = field(repr=False)
    spec_text: str = field(repr=False)  # as written
    spec_name: str  # file name of the spec
    resolved: str = field(repr=False)
    spec_hash: str
    seed: int  # seed of all random numbers of the batch
    trial: int  # index in the batch, from 0
    plant: PlantInfo
    start_unix_ns: int  # trial clock 0 in Unix time; EPOCH_NS in simulation
    # name and text of files that the spec names
    attached: tuple[tuple[str, str], ...] = field(default=(), repr=False)
    packages: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Step:
    """One control step k: observation, plan and command.

    `solve_ns` is the wall time of planning; `deadline_missed` is True if it exceeds the control
    period. Both values differ from run to run on the same seed.
    """

    k: int
    observation: Observation = field(repr=False)
    plan: Plan
    command: Command
    solve_ns: int
    deadline_missed: bool


@dataclass(frozen=True, slots=True)
class Result:
    """How a trial of N robots ended.

    `robot_errors` (N,) are the distances of the final positions to the targets and `total_error` is
    their sum [length unit]. `duration_s` is the time from the first direction sent to the stop, or
    from the opening of the plant if none was sent. `passed` (M,) are the sums of the robots'
    distances to the M way-points passed, `inside` (N,) the fraction of a hold's time that each
    robot was within the radius of its target, as defined by `TourMeasure`, and `lost` (N,) how
    often each robot was lost. `solve_ns` is the wall time that the controller needed for each
    control step, and `deadline_misses` the number of steps that took longer than the control
    period; both differ from run to run on the same seed. `drove` says of each step whether robots
    drove while it was planned, and is empty in older logs.

    A new number of a result is a field here, computed in `of` from what its callers pass
    (`run/control_loop.py`; `replay/result_check.py`, which checks it); a field of the message in
    `log/format/tetractl.proto`, written and read, or left empty by older logs, in `run_records.py`.
    """

    outcome: Outcome
    reason: str
    steps: int
    duration_s: float
    total_error: float
    robot_errors: tuple[float, ...]
    verdict: Verdict = field(repr=False)
    solve_ns: tuple[int, ...] = field(repr=False)
    deadline_misses: int = 0
    drove: tuple[bool, ...] = field(default=(), repr=False)
    passed: tuple[float, ...] = ()
    inside: tuple[float, ...] = ()
    lost: tuple[int, ...] = ()

    @classmethod
    def of(
        cls,
        setup: Setup,
        verdict: Verdict,
        *,
        outcome: Outcome,
        reason: str,
        duration_s: float,
        solve_ns: tuple[int, ...],
        deadline_misses: int,
        tour: TourMeasure,
        drove: tuple[bool, ...] = (),
    ) -> Self:
        """Return the result of a trial from the verdict and the record of its steps."""
        errors = verdict.final.distances(setup.targets)
        return cls(
            outcome=outcome,
            reason=reason,
            steps=len(solve_ns),
            duration_s=duration_s,
            total_error=float(errors.sum()),
            robot_errors=tuple(errors.tolist()),
            verdict=verdict,
            solve_ns=solve_ns,
            deadline_misses=deadline_misses,
            drove=drove,
            passed=tour.passed,
            inside=tour.inside,
            lost=tour.lost,
        )

    @property
    def summary(self) -> str:
        """The result as a sentence, the last message of a log."""
        reason = f" ({self.reason})" if self.reason else ""
        return f"{self.outcome.value}{reason} after {self.steps} control steps"

    @property
    def driving_ns(self) -> tuple[int, ...]:
        """The solve times of plans that were made while robots drove [ns]: there a plan must take
        less than a control period. In older logs, all but the first plan count."""
        drove = self.drove or (False, *(True,) * (len(self.solve_ns) - 1))
        return tuple(compress(self.solve_ns, drove))

    @property
    def entered_obstacle(self) -> bool:
        """Whether the centre of any robot entered an obstacle."""
        return any(self.verdict.in_obstacle())

    @property
    def left_arena(self) -> bool:
        """Whether the centre of any robot left the arena; False if the log does not record it."""
        return any(self.verdict.over_edge())


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialRecords:
    """All records of a trial of N robots with M camera frames, each kind in its order.

    Times are ns on the trial's clock, lengths in the experiment's unit, headings in rad. `mocap`
    (M, N, 3) are the measured poses at the times of exposure `mocap_ns` (M,), in the frames
    numbered `frames` (M,), which reached the host at `received_ns` (M,); `valid` (M, N) is False if
    a robot was not tracked, and `exposed_ns` (M, N) are when each pose was measured. `truth` (M, N,
    3) are the true poses of a simulation, None for a trial in the lab. `commands` are all commands:
    of the control steps, between them, and the stop; `notes` are the operator messages, such as a
    command that did not arrive. `result` is None if the run crashed or the end of the log is lost.
    """

    start: Start = field(repr=False)
    frames: Integers = field(repr=False)
    mocap_ns: Integers = field(repr=False)
    received_ns: Integers = field(repr=False)
    exposed_ns: Integers = field(repr=False)
    mocap: Floats = field(repr=False)
    valid: Bools = field(repr=False)
    truth: Floats | None = field(repr=False)
    commands: tuple[Command, ...] = field(repr=False)
    steps: tuple[Step, ...] = field(repr=False)
    notes: tuple[Note, ...] = field(repr=False)
    result: Result | None

    @property
    def tour(self) -> TourMeasure:
        """The measure of how the robots passed their way-points and held, up to the stop."""
        setup = self.start.setup
        stops = [command.sent_ns for command in self.commands if command.stops]
        measure = TourMeasure(setup.legs, setup.hold, setup.loss, setup.speed)
        for step in self.steps:
            measure.step(step.plan.leg, step.observation)
        samples = map(self.sample, range(len(self.frames)))
        measure.add(samples, until_ns=max(stops, default=None))
        return measure

    def sample(self, i: int) -> Sample:
        """Return the camera frame in row `i`."""
        exposed_ns = tuple(self.exposed_ns[i].tolist())
        observation = Observation(
            int(self.frames[i]),
            int(self.mocap_ns[i]),
            int(self.received_ns[i]),
            Poses.of(self.mocap[i]),
            self.valid[i],
            exposed_ns if any(pose_ns != self.mocap_ns[i] for pose_ns in exposed_ns) else (),
        )
        return Sample(observation, None if self.truth is None else Poses.of(self.truth[i]))

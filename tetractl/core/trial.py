"""The records of a trial: its plant, its start, each control step, its verdict and its result."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import compress
from typing import Self

import numpy as np

from tetractl.core.commands import Command
from tetractl.core.motion_estimate import Estimate
from tetractl.core.plan import Outcome, Plan
from tetractl.core.poses import Bools, Floats, Integers, Observation, Poses, Sample
from tetractl.core.route_measure import RouteMeasure
from tetractl.core.setup import Setup

SIMULATED_START_NS = 1_577_836_800_000_000_000
"""Start of all simulated trials, 2020-01-01 UTC, so that their logs can be reproduced [Unix ns]."""

RESERVED_FILE_NAMES = frozenset(
    {"spec.yaml", "spec.resolved.yaml", "environment.json", "layout.json"}
)
"""Names of the files that tetractl attaches to every log.

A spec must not name a file that has one of these names.
"""
HALTS_FACT = "halts"
"""Key in `PlantInfo.facts`. Its value is "yes" if a lab's robots stand still after a stop, or "no".
"""
EMULATED_PLANT = "emulated"
"""Type of the plant that emulates a lab in virtual time."""
EMULATED_DEVICES_FACT = "emulated"
"""Key in `PlantInfo.facts` for the names of the emulated devices, such as "camera"."""
REAL_DEVICE_FACT = "real"
"""Key in `PlantInfo.facts` for the real device of the plant `emulated`.

The key is absent if all devices are emulated.
"""


@dataclass(frozen=True, slots=True)
class PlantInfo:
    """A description of the robots of a trial, simulated or real, from the opened plant.

    The fact HALTS_FACT of a lab is "yes" if its robots stand still after a stop, otherwise "no".
    The fact EMULATED_DEVICES_FACT names the lab's emulated devices, such as "camera".

    Attributes:
        kind: Type of the plant.
        simulated: Whether the plant is a simulation.
        camera_rate_hz: Frame rate of the plant's camera [Hz].
        facts: Facts about the plant for the log's metadata, by key.
    """

    kind: str
    simulated: bool
    camera_rate_hz: float
    facts: dict[str, str]

    @property
    def virtual(self) -> bool:
        """Whether the trial ran in virtual time.

        This applies to simulations, and to the plant `emulated` unless it has a real device.
        """
        if self.kind == EMULATED_PLANT:
            return REAL_DEVICE_FACT not in self.facts
        return self.simulated


@dataclass(frozen=True, slots=True)
class Note:
    """A message for the operator, with its time in the trial.

    Attributes:
        t_ns: When the message was sent, on the trial's clock [ns].
        level: "info", "warning", "error" or "debug". A debug note is one line of an exception's
            traceback, and only the log contains it.
        text: The message.
    """

    t_ns: int
    level: str
    text: str


@dataclass(frozen=True, slots=True)
class Verdict:
    """The plant's verdict on a trial of N robots, measured on the finest samples of their paths.

    Distances are in the spec's length unit, between the centres of robots. The methods can take a
    body `radius` into account.

    Attributes:
        final: Poses after the stop.
        entered: Whether the path of each robot touched an obstacle, according to
            `model.path_check`.
        clearance: Minimum distance of each robot to an obstacle. Negative inside, inf without
            obstacles.
        not_at_rest: Describes the robots that did not stand still after the stop. Empty if all did.
        edge: Minimum distance of each robot to the edge of the arena. Negative outside. Empty in
            older logs.
        apart: Minimum distance of each robot to another robot. inf for a single robot. Empty in
            older logs.
        turn: Rate at which each robot turned off course while it drove [rad/s]. Empty except in a
            lab with robots on wheels.
        turn_std: Standard error of `turn` [rad/s]. inf if it is unknown. Empty where `turn` is.
        unrest: Names the robots that may still be driving after the trial.
        can_restart: Whether another trial can start without anybody touching a robot or a device.
            Logs do not contain it.
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
        """Create a verdict for N robots whose final positions are unknown.

        The positions are NaN, no robot entered an obstacle, and another trial cannot start by
        itself.
        """
        unknown_poses = Poses.from_array(np.full((robots, 3), np.nan))
        return cls(unknown_poses, (False,) * robots, (math.inf,) * robots, can_restart=False)

    def in_obstacle(self, radius: float = 0.0) -> list[bool]:
        """Return for each robot whether it entered an obstacle, N entries.

        A positive `radius` [length unit] also counts a robot whose centre came closer to an
        obstacle than this.
        """
        return [
            entered or gap < radius
            for entered, gap in zip(self.entered, self.clearance, strict=True)
        ]

    def over_edge(self, radius: float = 0.0) -> list[bool]:
        """Return for each robot whether it came closer than `radius` to the edge of the arena.

        With radius 0, this means that it left the arena. Empty if the log does not record it.
        """
        return [edge < radius for edge in self.edge]

    def touched(self, radius: float = 0.0) -> list[bool]:
        """Return for each robot whether its centre came within 2 `radius` of another robot's.

        Empty if the log does not record it.
        """
        return [apart < 2 * radius for apart in self.apart]


@dataclass(frozen=True, slots=True)
class Start:
    """The record of a trial's start: what is known before the first control step.

    Attributes:
        setup: The constants of the experiment.
        spec_text: The spec as written.
        spec_name: Name of the spec's file.
        resolved: The spec as YAML with all fields, including defaults and `--set`.
        spec_hash: SHA-256 of the spec's values, as 64 hex digits.
        seed: Seed of all random numbers of the batch.
        trial: Index of the trial in the batch, from 0.
        plant: Description of the plant.
        start_unix_ns: Time at which the trial's clock is 0 [Unix ns]. SIMULATED_START_NS in a
            simulation.
        attached: Name and text of each further file that the spec names.
        packages: Name and version of the packages, other than tetractl, that provide a kind used by
            the spec.
    """

    setup: Setup = field(repr=False)
    spec_text: str = field(repr=False)
    spec_name: str
    resolved: str = field(repr=False)
    spec_hash: str
    seed: int
    trial: int
    plant: PlantInfo
    start_unix_ns: int
    attached: tuple[tuple[str, str], ...] = field(default=(), repr=False)
    packages: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Step:
    """The record of one control step: the observation, the plan and the command.

    Attributes:
        k: Number of the control step, from 0.
        observation: The camera frame that the controller received.
        plan: The controller's plan.
        command: The command that was sent.
        solve_ns: Wall time of planning [ns]. It differs from run to run.
        deadline_missed: Whether planning took longer than the control period. It differs from run
            to run.
    """

    k: int
    observation: Observation = field(repr=False)
    plan: Plan
    command: Command
    solve_ns: int
    deadline_missed: bool


@dataclass(frozen=True, slots=True)
class Result:
    """The result of a trial of N robots: its outcome, and its numbers.

    Attributes:
        outcome: How the trial ended.
        reason: Why the trial ended, as a sentence. Empty if the outcome says enough.
        steps: Number of control steps.
        duration_s: Time from the first direction sent to the stop [s]. If no direction was sent,
            time since the plant was opened.
        total_error: Sum of `robot_errors` [length unit].
        robot_errors: Distance of each robot's final position to its target [length unit], N
            entries.
        verdict: Measurements of the plant.
        solve_ns: Wall time that the controller needed in each control step [ns]. It differs from
            run to run, even with the same seed.
        deadline_misses: Number of steps in which the controller took longer than the control
            period. It also differs from run to run.
        drove: Whether robots drove while each step was planned. Empty in older logs.
        passed: Sum of the robots' distances to each way-point that was passed [length unit].
        inside: Fraction of a hold's time that each robot was near its target, as `RouteMeasure`
            defines it. Empty without a hold.
        lost: How often each robot was lost. Empty if no robot was.
        wheel_lag_s: Lag of the wheels that the controller has estimated [s], the mean of all
        robots.
            None if the controller does not estimate it.

    To add a number, add a field here and compute it in `from_verdict` from the arguments of its
    callers (`run/control_loop.py`, and `verification/result_check.py`, which checks it). A number
    that is measured along the robots' true paths, such as a length or a distance, is a field of
    `Verdict` instead: `model/path_check.py` computes it, in simulations and labs. Then add a field
    to the message in `log/format/tetractl.proto`, write and read it in `run_records.py`, check it
    in `log/read/validate.py`, and describe it in docs/reference/log-format.md. Older logs leave it
    empty, and new logs get other content digests.
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
    wheel_lag_s: float | None = None

    @classmethod
    def from_verdict(
        cls,
        setup: Setup,
        verdict: Verdict,
        *,
        outcome: Outcome,
        reason: str,
        duration_s: float,
        solve_ns: tuple[int, ...],
        deadline_misses: int,
        route: RouteMeasure,
        drove: tuple[bool, ...] = (),
        estimate: Estimate | None = None,
    ) -> Self:
        """Compute the result of a trial from its verdict and the record of its steps.

        Args:
            setup: The constants of the experiment.
            verdict: Measurements of the plant.
            outcome: How the trial ended.
            reason: Why the trial ended, as a sentence. Empty if the outcome says enough.
            duration_s: Time from the first direction sent to the stop [s].
            solve_ns: Wall time of the controller in each control step [ns].
            deadline_misses: Number of steps that took longer than the control period.
            route: The measurement of way-points, hold and lost robots.
            drove: Whether robots drove while each step was planned.
            estimate: The controller's last estimate of the motion. None if it makes none.
        """
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
            passed=route.passed,
            inside=route.inside,
            lost=route.lost,
            wheel_lag_s=None if estimate is None else estimate.common_lag,
        )

    @property
    def summary(self) -> str:
        """The result as a sentence: outcome, reason and number of steps.

        This is the last message of a log.
        """
        reason = f" ({self.reason})" if self.reason else ""
        return f"{self.outcome.value}{reason} after {self.steps} control steps"

    @property
    def driving_ns(self) -> tuple[int, ...]:
        """The wall times of planning in steps in which the robots drove [ns].

        Only these steps must take less than a control period. In older logs, all steps but the
        first count.
        """
        drove = self.drove or (False, *(True,) * (len(self.solve_ns) - 1))
        return tuple(compress(self.solve_ns, drove))

    @property
    def entered_obstacle(self) -> bool:
        """Whether the centre of any robot was in an obstacle during the trial."""
        return any(self.verdict.in_obstacle())

    @property
    def left_arena(self) -> bool:
        """Whether the centre of any robot left the arena. False if the log does not record it."""
        return any(self.verdict.over_edge())


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialRecords:
    """Everything that was recorded in a trial of N robots with M camera frames.

    Times are ns on the trial's clock, lengths in the experiment's unit, headings in rad.

    Attributes:
        start: The record of the start.
        frames: Number of each camera frame, shape (M,).
        mocap_ns: Time of exposure of each frame, shape (M,).
        received_ns: When each frame reached the host, shape (M,).
        exposed_ns: When each pose was measured, shape (M, N).
        mocap: Measured poses, shape (M, N, 3): x, y, heading.
        valid: Whether each robot was tracked, shape (M, N).
        truth: True poses, shape (M, N, 3). None for a trial in the lab.
        commands: All commands: in the control steps, between them, and the stop.
        steps: The control steps.
        notes: Messages to the operator, for example that a command did not arrive.
        result: How the trial ended. None if the run crashed or the end of the log is lost.
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
    def route(self) -> RouteMeasure:
        """The measurement of how the robots passed way-points and held, up to the last stop."""
        setup = self.start.setup
        stops = [command.sent_ns for command in self.commands if command.stops]
        measure = RouteMeasure(setup.legs, setup.hold, setup.loss, setup.speed)
        for step in self.steps:
            measure.record_step(step.plan.leg, step.observation)
        samples = map(self.sample, range(len(self.frames)))
        measure.add_samples(samples, until_ns=max(stops, default=None))
        return measure

    def sample(self, i: int) -> Sample:
        """Return the camera frame in row `i` of the trial's arrays."""
        exposed_ns = tuple(self.exposed_ns[i].tolist())
        observation = Observation(
            int(self.frames[i]),
            int(self.mocap_ns[i]),
            int(self.received_ns[i]),
            Poses.from_array(self.mocap[i]),
            self.valid[i],
            exposed_ns if any(pose_ns != self.mocap_ns[i] for pose_ns in exposed_ns) else (),
        )
        return Sample(observation, None if self.truth is None else Poses.from_array(self.truth[i]))

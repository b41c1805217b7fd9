"""What robots are commanded to do, and the records that a plant and the devices of a lab return:
samples, commands, verdict, health.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from tetractl.core.poses import Floats, Observation, Poses

HALTS = "halts"
"""The fact of a lab that says whether its robots stand still after a stop."""


@dataclass(frozen=True, slots=True)
class Steer:
    """All robots drive and turn towards the common direction u [rad]."""

    direction: float


@dataclass(frozen=True, slots=True)
class Turn:
    """All robots stand and turn on the spot towards a direction [rad], by (3) at speed 0."""

    facing: float


@dataclass(frozen=True, slots=True)
class Stop:
    """All robots stand."""


@dataclass(frozen=True, slots=True)
class FieldOff:
    """The field is off: no robot is turned, and all go straight on."""


Action = Steer | Turn | Stop | FieldOff
"""What one command makes all robots do."""


@dataclass(frozen=True, slots=True)
class Sent:
    """An action, and when it was sent [ns] on the clock of the trial or run."""

    action: Action
    sent_ns: int

    @property
    def direction(self) -> float | None:
        """The common direction u [rad], None if the action gives none."""
        return self.action.direction if isinstance(self.action, Steer) else None

    @property
    def stops(self) -> bool:
        """Whether no robot drives; robots may turn on the spot."""
        return isinstance(self.action, Stop | Turn)


@dataclass(frozen=True, slots=True)
class FrameAddition:
    """What a camera knows of the frame exposed at `sampled_ns` beyond its poses.

    `messages`, topic and protobuf bytes, are logged as they are; a camera may use the channels of
    pictures, `log.format.channels`.
    """

    sampled_ns: int
    messages: tuple[tuple[str, bytes], ...] = ()


@dataclass(frozen=True, slots=True)
class Sample:
    """One camera frame and the true poses at its exposure; `truth` is None outside simulations.

    `messages`, topic and bytes, are what its camera adds to the frame's record.
    """

    observation: Observation
    truth: Poses | None
    messages: tuple[tuple[str, bytes], ...] = ()


@dataclass(frozen=True, slots=True)
class Command(Sent):
    """One command as it was sent to N robots.

    `delivered` (N,) is False for a robot that did not receive it, as far as is known. `left`,
    `right` (N,) are the wheel speeds of the paper's equations (24)-(25) [length unit/s], None for
    robots without wheels; these arrays cannot be written.
    """

    delivered: tuple[bool, ...]
    left: Floats | None = None
    right: Floats | None = None

    def __post_init__(self) -> None:
        if self.left is not None and self.right is not None:
            self.left.setflags(write=False)
            self.right.setflags(write=False)


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
    standard error, inf if it is unknown [rad/s]; otherwise both are empty.
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

    @classmethod
    def unknown(cls, robots: int) -> Self:
        """Return the verdict on N robots of which the plant could not tell where they stopped."""
        nowhere = Poses.of(np.full((robots, 3), np.nan))
        return cls(nowhere, (False,) * robots, (math.inf,) * robots)

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


EMULATED_PLANT = "emulated"
"""The type of the plant that emulates a lab in virtual time."""
EMULATED_DEVICES = "emulated"
"""The key of `PlantInfo.facts` whose value names the emulated devices."""
REAL_DEVICE = "real"
"""The key of `PlantInfo.facts` that names the real device of plant `emulated`, if there is one."""
EMULATED_NAME = "EMULATED by tetractl"
"""Text in the name that an emulated device reports to its client."""


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
class Transmission(Sent):
    """One transmission of an actuator to N robots.

    `moving` (N,) is False for robots that are
    held still. `speed` (N,) [length unit/s] and `turning` (N,) [rad/s] are the motion commanded to
    each robot. `left`, `right` (N,) are the wheel speeds [length unit/s] of robots with wheels.
    `outputs` are further numbers of the actuator by a name that includes the unit, such as
    `current_x_a`.
    """

    moving: tuple[bool, ...]
    speed: Floats
    turning: Floats
    left: Floats | None = None
    right: Floats | None = None
    outputs: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """The answer of one robot to a poll; `answers` is None for a robot that cannot answer. It gives
    the voltage of its battery [V], or its charge [%], or neither."""

    answers: bool | None
    battery_v: float | None = None
    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    charge: int | None = None

    @property
    def battery(self) -> str | None:
        """The voltage or the charge, for display; None if neither is known."""
        if self.battery_v is not None:
            return f"{self.battery_v:.2f} V"
        return None if self.charge is None else f"{self.charge} %"


@dataclass(frozen=True, slots=True)
class Health:
    """The state of a device of the lab before a run.

    `problems` prevent a run from starting, `warnings` do not, and `questions` need the operator's
    consent; all are lines of text. The log's metadata hold the `facts`. `emulated` is True if the
    device reports that it is not real; all tables and figures then mark the trial as emulated.
    """

    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    questions: tuple[str, ...] = ()
    emulated: bool = False

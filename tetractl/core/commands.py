"""What passes between a trial and its plant: camera samples, commands, notes and the verdict."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from tetractl.core.poses import Floats, Observation, Poses


@dataclass(frozen=True, slots=True)
class Sample:
    """One camera frame as it came, with the true poses where a simulation knows them."""

    observation: Observation
    truth: Poses | None


@dataclass(frozen=True, slots=True)
class Command:
    """What was really sent to the robots.

    `direction` is the common direction u [rad], None for a stop; `sent_ns` when it left and
    `delivered` (N,) whether each robot got it, as far as the plant can know. `left`, `right` (N,)
    are the wheel speeds of (24)-(25) [length unit/s] where the robots have wheels.
    """

    direction: float | None
    sent_ns: int
    delivered: tuple[bool, ...]
    left: Floats | None = None
    right: Floats | None = None


@dataclass(frozen=True, slots=True)
class Note:
    """A message for people; `level` is "info", "warning" or "error"."""

    t_ns: int
    level: str
    text: str


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the plant's own path says of the trial, sampled as finely as the plant can.

    `entered` (N,) tells which robots were ever inside an obstacle, `clearance` (N,) is each one's
    least distance to one [length unit], negative inside, inf without obstacles. `unrest` says who
    still moved after the stop, "" where all stood.
    """

    final: Poses
    entered: tuple[bool, ...]
    clearance: tuple[float, ...]
    unrest: str = ""


@dataclass(frozen=True, slots=True)
class PlantInfo:
    """What a plant says of itself when opened; `facts` go into the log's metadata."""

    kind: str
    simulated: bool
    camera_rate_hz: float
    facts: dict[str, str]


@dataclass(frozen=True, slots=True)
class Transmission:
    """One transmission of an actuator to N robots.

    `sent_ns` is when it left, on the run's clock; `direction` the common direction u [rad], None
    for a stop; `moving` (N,) tells which robots move by it. `speed` (N,) [length unit/s] and
    `turning` (N,) [rad/s] are the motion it asks of each robot. `left`, `right` (N,) are the wheel
    speeds [length unit/s] of robots with wheels. `outputs` are the actuator's own numbers by a name
    with its unit, such as `current_x_a`.
    """

    sent_ns: int
    direction: float | None
    moving: tuple[bool, ...]
    speed: Floats
    turning: Floats
    left: Floats | None = None
    right: Floats | None = None
    outputs: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """What one robot answered when it was polled; `answers` None where it cannot answer at all."""

    answers: bool | None
    battery_v: float | None = None
    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Health:
    """What a device of the lab says of itself before a run.

    `problems` keep a run from starting, `warnings` do not; both are lines for people. `facts` go
    into the log's metadata.
    """

    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)

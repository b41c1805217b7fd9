"""The seam behind the controller: a plant is observed, steered and stopped."""

from dataclasses import dataclass
from typing import Protocol

from tetractl.model.state import Floats, Observation, Poses


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
    """Something a person should know of: `level` is "info", "warning" or "error"."""

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


class Plant(Protocol):
    """N robots under one control signal, simulated or real.

    Calls come in this order: open, then any of observe, steer, samples and news, then stop, settle,
    close.
    Times are nanoseconds on the clock the plant was made with, 0 at the trial's start.
    """

    def open(self) -> PlantInfo:
        """Make ready; raise AbortError where the plant cannot run."""
        ...

    def observe(self) -> Observation:
        """Return the newest camera frame."""
        ...

    def steer(self, direction: float) -> Command:
        """Send the common direction u [rad] and return what was really sent."""
        ...

    def samples(self) -> list[Sample]:
        """Return, once, every camera frame since the last call, oldest first."""
        ...

    def news(self) -> list[Command | Note]:
        """Return, once, what was sent outside `steer` and what was noted, oldest first."""
        ...

    def stop(self) -> Command:
        """Stop every robot; idempotent, never raises."""
        ...

    def settle(self) -> Verdict:
        """After stop: wait until the robots stand still, and judge the path."""
        ...

    def close(self) -> None:
        """Release what open took; idempotent, never raises."""
        ...

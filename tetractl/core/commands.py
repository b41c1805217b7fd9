"""What robots are commanded to do, and what was sent to them for it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from tetractl.core.poses import Floats


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
class Command:
    """An action as it was sent to N robots, at `sent_ns` [ns] on the clock of the trial or run.

    `delivered` (N,) is False for a robot that did not receive it, as far as is known. `left`,
    `right` (N,) are the wheel speeds of the paper's equations (24)-(25) [length unit/s], None for
    robots without wheels; these arrays cannot be written.
    """

    action: Action
    sent_ns: int
    delivered: tuple[bool, ...]
    left: Floats | None = None
    right: Floats | None = None

    def __post_init__(self) -> None:
        if self.left is not None and self.right is not None:
            self.left.setflags(write=False)
            self.right.setflags(write=False)

    @property
    def direction(self) -> float | None:
        """The common direction u [rad], None if the action gives none."""
        return self.action.direction if isinstance(self.action, Steer) else None

    @property
    def stops(self) -> bool:
        """Whether no robot drives; robots may turn on the spot."""
        return isinstance(self.action, Stop | Turn)


@dataclass(frozen=True, slots=True, kw_only=True)
class Transmission(Command):
    """A command as the actuator of a lab has sent it: an action is sent to robots again and again.

    A robot that is held still while others move counts as one that did not receive the action.
    `speed` (N,) [length unit/s] and `turning` (N,) [rad/s] are the motion commanded to each robot.
    `outputs` are further numbers of the actuator by a name that includes the unit, such as
    `current_x_a`.
    """

    speed: Floats
    turning: Floats
    outputs: Mapping[str, float] = field(default_factory=dict)

"""The actions that robots can be commanded to do, and records of what was really sent."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from tetractl.core.poses import Floats


@dataclass(frozen=True, slots=True)
class Steer:
    """An action: all robots drive and turn towards the common direction u [rad].

    Attributes:
        direction: The common direction u [rad].
        lag_s: Lag of the wheels that the host assumes, starting with this command [s]. None to keep
            the lag that it assumed before, which is the spec's lag at first.
    """

    direction: float
    lag_s: float | None = None


@dataclass(frozen=True, slots=True)
class Turn:
    """An action: all robots stay in place and turn towards the direction `facing` [rad].

    They turn by the paper's equation (3) with speed 0.
    """

    facing: float


@dataclass(frozen=True, slots=True)
class Stop:
    """An action: all robots stand still."""


@dataclass(frozen=True, slots=True)
class FieldOff:
    """An action: the magnetic field is off. Cells do not turn, and swim straight on."""


Action = Steer | Turn | Stop | FieldOff
"""What one command makes all robots do: drive, turn, stand still, or swim unsteered."""


@dataclass(frozen=True, slots=True)
class Command:
    """The record of an action, such as a direction or a stop, that was sent to N robots.

    Attributes:
        action: The action that the robots were to perform.
        sent_ns: When it was sent, on the clock of the trial or run [ns].
        delivered: Whether each robot received it, as far as is known, N entries.
        left: Speeds of the left wheels in the paper's equation (24) [length unit/s], shape (N,),
            read-only. None for robots without wheels.
        right: Speeds of the right wheels in the paper's equation (25), like `left`.
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
        """The common direction u in which the robots drive [rad].

        None if the robots turn on the spot or stop, or if the field is off.
        """
        return self.action.direction if isinstance(self.action, Steer) else None

    @property
    def stops(self) -> bool:
        """Whether no robot drives, because the action is a stop or a turn on the spot."""
        return isinstance(self.action, Stop | Turn)


@dataclass(frozen=True, slots=True, kw_only=True)
class Transmission(Command):
    """The record of a command that the actuator of a lab sent.

    The actuator sends an action repeatedly. A robot that is held still while others move counts as
    a robot that did not receive the action.

    Attributes:
        speed: Commanded speed of each robot [length unit/s], shape (N,).
        turning: Commanded turning rate of each robot [rad/s], shape (N,).
        outputs: Further values of the actuator. Each name ends with its unit, such as
            `current_x_a`.
    """

    speed: Floats
    turning: Floats
    outputs: Mapping[str, float] = field(default_factory=dict)

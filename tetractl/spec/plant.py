"""The part `plant` of a spec: the simulation or the lab that the controller steers."""

from abc import abstractmethod
from collections.abc import Iterator
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

import numpy as np

from tetractl.core.clock import Clock
from tetractl.core.poses import UNKNOWN_SIGHT, Floats, Sight
from tetractl.core.protocols import LabSupervision, Plant
from tetractl.core.setup import Setup
from tetractl.spec.base import Model, NonNegative, Positive
from tetractl.spec.yaml.problems import Loc

Lengths = TypeVar("Lengths", float, Floats)


@runtime_checkable
class Microscope(Protocol):
    """The fields of a camera whose logged images can be placed in the arena."""

    @property
    def um_px(self) -> float:
        """How many micrometres in the dish correspond to one pixel of the image."""
        ...

    def placed(self, x_um: Lengths, y_um: Lengths, metres: float) -> tuple[Lengths, Lengths]:
        """Convert positions in an image [um] to the spec's coordinates [length unit].

        Args:
            x_um: x from the lower left corner of the image [um], a number or shape (N,).
            y_um: y from the lower left corner of the image [um], like `x_um`.
            metres: The spec's length unit [m].
        """
        ...


class PlantSection(Model):
    """Base class of the part `plant` of a spec. Each kind is in the file of its plant."""

    type: Any  # the section's name, a Literal in each subclass
    simulated: ClassVar[bool]
    """Whether the plant is a simulation, which runs in virtual time.

    With the same seed, a simulation repeats exactly.
    """
    switches_field: ClassVar[bool] = False
    """Whether `steer(None)` works: the plant can switch the field off while robots move."""

    @property
    def real_time(self) -> bool:
        """Whether the plant drives real devices, so that it needs real time and an operator."""
        return not self.simulated

    @property
    def loses_frames(self) -> bool:
        """Whether camera frames may be lost in transit, so that gaps in a log are not damage.

        By default, this is true of every plant except a simulation.
        """
        return not self.simulated

    @abstractmethod
    def clock(self) -> Clock:
        """Create a new clock: virtual for a simulation, and monotonic for a lab."""

    @property
    def microscope(self) -> Microscope | None:
        """The camera, if its images have a known scale and position.

        Otherwise None, which is the default.
        """
        return None

    @property
    def sight(self) -> Sight:
        """How precisely a lab's camera measures, as far as the spec says.

        It is unknown for a simulation, even if the spec gives the simulated measurement noise.
        """
        return UNKNOWN_SIGHT

    def require_devices(self) -> None:
        """Raise AbortError if a lab's port does not exist. No device is opened.

        By default, there are no devices to check.
        """

    @abstractmethod
    def build(
        self, setup: Setup, clock: Clock, seed: np.random.SeedSequence, supervision: LabSupervision
    ) -> Plant:
        """Create the plant of one trial, which the controller steers.

        Args:
            setup: The constants of the experiment.
            clock: The clock of the trial.
            seed: Seed of a simulation's disturbances.
            supervision: The operator's prompts, emergency stop and cancel signal. Only labs use
                them.
        """

    @property
    def disturbed(self) -> bool:
        """Whether a simulation has any disturbance.

        Only disturbed simulations are compared with a published result.
        """
        return False

    def bounds(self) -> dict[str, str]:
        """Describe the limits of a trial on this plant for display, as {name: text}.

        Empty by default.
        """
        return {}

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield each field of the plant that contradicts another field, with a message.

        Locations are relative to this section.
        """
        yield from ()


class Wheels(Model):
    """Geometry of a two-wheeled robot that moves like a cell (the paper's equations (21)-(25))."""

    radius: Positive
    """Distance r from a wheel to the robot's centre [length unit]."""
    watchdog: Positive | None = None
    """Time without a command after which a robot stops by itself [s]; 0.25 for the m3pi firmware.
    Its next command moves it again. By default, a robot never stops by itself.
    """
    lag: NonNegative = 0.0
    """Time constant with which the wheels follow a command [s].

    If it is not 0, the host computes wheel speeds for the headings that the robots will have by
    then, and the controller predicts the poses in which the robots come to a standstill. A
    controller that estimates the lag starts from this value, and sends its estimate to the host.
    """

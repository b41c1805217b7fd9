"""Faults of the emulated Motive that its frames do not show by themselves: clock and ids."""

from typing import TYPE_CHECKING, ClassVar, Literal

from tetractl.core.clock import SECOND
from tetractl.experiment.base import Finite, Name, Positive
from tetractl.lab.emulate.faults import Fault, Undo, Visible, setting

if TYPE_CHECKING:
    from tetractl.lab.emulate.optitrack.side import EmulatedOptitrack


class ClockJump(Fault):
    """The camera server's clock is set."""

    fault: Literal["clock_jump"]
    by: Finite
    """By how much, forward where it is positive [s]."""

    def begin(self, device: "EmulatedOptitrack") -> Undo:
        """Set the clock."""
        clock = device.motive.server.clock
        return setting(clock, ahead_ns=clock.ahead_ns + round(self.by * SECOND))


class ClockRate(Fault):
    """The camera server's clock runs fast or slow."""

    fault: Literal["clock_rate"]
    rate: Positive
    """How much it gains for each second."""

    def begin(self, device: "EmulatedOptitrack") -> Undo:
        """Let the clock run so from now on."""
        clock = device.motive.server.clock
        return setting(clock, rate=self.rate, since_ns=device.motive.now_ns)


class TwinId(Fault):
    """A body has the id of another."""

    visible: ClassVar[Visible] = Visible.EXPOSED
    fault: Literal["twin_id"]
    robot: Name
    """The robot whose body has the other's id."""
    other: Name
    """The robot that the id belongs to."""

    def begin(self, device: "EmulatedOptitrack") -> Undo:
        """Give the body the id."""
        return setting(device.tracked_body(self.robot), id=device.tracked_body(self.other).id)


SERVER_FAULTS = (ClockJump, ClockRate, TwinId)

"""`actuator: {type: vw}`: robots that take lines `v w` by UDP: speed [m/s] and rate [rad/s]."""

from typing import ClassVar, Literal

from tetractl.lab.actuators.own_robots import OwnRobots
from tetractl.lab.actuators.own_section import OwnSection


class VwSection(OwnSection):
    """Robots with two wheels that take lines `v w`, and stop 250 ms after the last one."""

    device: ClassVar[str] = "tetractl_vw.actuator:VwRobots"
    watchdog_s: ClassVar[float] = 0.25
    type: Literal["vw"]


class VwRobots(OwnRobots):
    """A `tetractl.core.protocols.Actuator`."""

    def packed(self, row, left, right):
        """Return the line for wheel speeds [mm/s]."""
        v, w = (left + right) / 2000, (right - left) / (2 * self.radii[row])
        return f"{v:.4f} {w:.4f}\n".encode()

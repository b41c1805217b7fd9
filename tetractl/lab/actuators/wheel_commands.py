"""What is common to actuators of robots on two wheels: the speeds to send for a direction, and what
robots reply."""

import math
from collections.abc import Sequence
from enum import IntFlag

import numpy as np

from tetractl.core.clock import SECOND, Clock
from tetractl.core.commands import RobotStatus, Steer, Turn
from tetractl.core.poses import Floats, Pose
from tetractl.core.setup import MM, Setup
from tetractl.model.wheels import Drivetrains, WheelHost

AHEAD_NS = SECOND // 10  # longest time over which headings are predicted
EMPTY_V = 4.0  # voltage of four cells below which motors would soon fail


class Status(IntFlag):
    """Status flags of a robot."""

    RUNNING = 1  # the last frame set the run flag
    EMERGENCY_STOPPED = 2
    SILENT = 4  # stopped by the watchdog


class WheelCommands:
    """Computes the wheel speeds of a setup's robots, whose wheels are `drivetrains` and `radius_mm`
    (N,) from their centres; a command reaches the wheels `delay_ns` after it is sent."""

    def __init__(
        self,
        setup: Setup,
        clock: Clock,
        radius_mm: Sequence[float | None],
        drivetrains: Drivetrains,
        delay_ns: int,
    ) -> None:
        self._clock, self._delay_ns = clock, delay_ns
        self.mm = setup.metres / MM  # millimetres per length unit of the spec
        radii, speed = radii_mm(setup, radius_mm), setup.speed * self.mm
        self.host = WheelHost(setup.a, speed, radii, setup.lag_s, drivetrains)

    def wished(self, action: Steer | Turn, poses: Sequence[Pose | None], exposed_ns: int) -> Floats:
        """Return the wheel speeds (2, N) [mm/s] by `WheelHost`.

        Headings are predicted from the time of the poses, `exposed_ns`, to the time when the
        command reaches the wheels, over at most AHEAD_NS. Robots without a pose stand.
        """
        arrives = self._clock.now() + self._delay_ns
        since = max(exposed_ns, arrives - AHEAD_NS)
        heading = np.array([0.0 if pose is None else pose.heading for pose in poses])
        drives = isinstance(action, Steer)
        u = action.direction if drives else action.facing
        wished = self.host.wished(heading, u, since, arrives, drives)
        wished[:, [pose is None for pose in poses]] = 0.0
        return wished

    def sent(self, sent_ns: int, speeds: Floats) -> tuple[Floats, Floats]:
        """Take wheel speeds (2, N) [mm/s] that were sent; return the robots' speeds [length unit/s]
        and turning rates [rad/s]."""
        speed, turning = self.host.sent(sent_ns + self._delay_ns, speeds)
        return speed / self.mm, turning


def radii_mm(setup: Setup, own: Sequence[float | None]) -> Floats:
    """Return the distances (N,) from robots' wheels to their centres [mm], by default the spec's;
    NaN for those of which neither is given."""
    radius = math.nan if setup.wheel_radius is None else setup.wheel_radius * setup.metres / MM
    return np.array([radius if one is None else one for one in own])


def robot_status(
    name: str, status: Status | None, battery_mv: int = 0, warn_v: float = 0.0
) -> RobotStatus:
    """Return what a robot's reply says to the operator; `status` is None if it gave none."""
    if status is None:
        line = f"{name} does not answer: is it on, and is its index right?"
        return RobotStatus(False, problems=(line,))
    volts = battery_mv / 1000 or None
    if status & Status.EMERGENCY_STOPPED:
        line = f"{name} is emergency-stopped: switch it off and on again"
        return RobotStatus(True, volts, (line,))
    if volts is not None and volts < EMPTY_V:
        return RobotStatus(True, volts, (f"{name}'s battery is at {volts:.2f} V: charge it",))
    if volts is not None and volts < warn_v:
        return RobotStatus(True, volts, (), (f"{name}'s battery is at {volts:.2f} V",))
    return RobotStatus(True, volts)

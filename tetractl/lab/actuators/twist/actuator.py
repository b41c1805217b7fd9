"""The actuator of robots on two wheels that receive their speeds as lines of text."""

import numpy as np

from tetractl.core.clock import SECOND, Clock
from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.lab.actuators.twist.line_ports import TwistLink
from tetractl.lab.actuators.twist.lines import SPEED_MAX, TURN_MAX
from tetractl.lab.actuators.twist.section import TwistSection
from tetractl.lab.actuators.wheel_commands import WheeledActuator, wheels_by_speed
from tetractl.lab.serial_port import PortFactory
from tetractl.model.wheels import CountArray
from tetractl.spec.lab_section import entry


class TwistActuator(WheeledActuator):
    """The actuator for robots that take lines of text; see `tetractl.core.protocols.Actuator`.

    Args:
        section: The fields of the actuator in the spec.
        setup: The constants of the experiment.
        clock: The clock for times.
        ports: Creates the ports of the `TwistLink`. None for ports of this computer.
    """

    def __init__(
        self, section: TwistSection, setup: Setup, clock: Clock, ports: PortFactory | None = None
    ) -> None:
        self.section = section
        self.link = TwistLink(section, setup.names, clock, ports)
        robots = [entry(section.robots, name) for name in setup.names]
        self._gain = np.array([(robot.left_gain, robot.right_gain) for robot in robots]).T
        super().__init__(
            setup,
            clock,
            link=self.link,
            stated_radii_mm=[robot.radius_mm for robot in robots],
            drivetrains=wheels_by_speed(self._gain, section.speed_max_mm_s),
            delay_ns=round(section.delay * SECOND),
            rate=section.rate,
            ask=self.link.poll,
            warn_v=section.battery_warn,
        )

    def _halt(self, emergency: bool) -> int:
        """Send one stop to all robots; see `WheeledActuator`."""
        return self.link.stop(emergency)

    def _drive(self, outputs: CountArray) -> tuple[int, Floats]:
        """Send each robot its wheel speeds, or a speed and a turning rate, in one line."""
        wheel_speeds = outputs.astype(float)
        sent_numbers = wheel_speeds
        if self.section.sends != "wheels":
            sent_numbers = self._compute_twists(wheel_speeds)
            # as the robots compute them from rounded numbers
            wheel_speeds = self._compute_wheel_speeds(sent_numbers)
        sent_ns = self.link.drive([(int(first), int(second)) for first, second in sent_numbers.T])
        return sent_ns, wheel_speeds * self._gain

    def _compute_twists(self, wheels: Floats) -> Floats:
        """Convert wheel speeds (2, N) [mm/s] to whole speeds and turning rates by (21)-(23).

        The result has shape (2, N): speeds [mm/s] and turning rates [mrad/s].
        """
        v = wheels.sum(axis=0) / 2
        w = (wheels[1] - wheels[0]) / (2 * self.radii)
        limits = np.array([[SPEED_MAX], [TURN_MAX]])
        return np.clip(np.rint(np.array([v, 1000 * w])), -limits, limits)

    def _compute_wheel_speeds(self, twists: Floats) -> Floats:
        """Convert speeds and turning rates that were sent back to wheel speeds (2, N) [mm/s]."""
        rim = twists[1] * self.radii / 1000
        return np.array([twists[0] - rim, twists[0] + rim])

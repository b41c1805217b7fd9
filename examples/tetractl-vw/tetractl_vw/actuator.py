"""`actuator: {type: vw}`: robots that take lines `v w` by UDP: speed [m/s] and rate [rad/s]."""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from tetractl.core.clock import SECOND
from tetractl.core.commands import Health, RobotStatus, Stop
from tetractl.core.errors import AbortError
from tetractl.experiment.lab_section import ActuatorSection, RobotPart, entry, mismatches
from tetractl.lab.actuators.twist.actuator import drivetrains
from tetractl.lab.actuators.wheel_commands import WheelCommands, WheeledActuator, radii_mm
from tetractl.lab.udp_port import SCHEME, address_of, open_port

HINT = "is the robot on, and in this computer's network?"


class VwRobot(RobotPart):
    """A robot's entry in the actuator's section."""

    address: str
    """Where its lines go: udp://HOST:PORT."""
    radius_mm: float | None = Field(default=None, gt=0, le=1000)
    """Distance r from a wheel to the centre [mm], as in its program; by default the spec's."""
    left_gain: float = Field(default=1.0, ge=0.2, le=5)
    """True speed of the left wheel over the speed that it was sent."""
    right_gain: float = Field(default=1.0, ge=0.2, le=5)
    """True speed of the right wheel over the speed that it was sent."""


class VwSection(ActuatorSection):
    """Robots with two wheels that take lines `v w`, and stop 250 ms after the last one."""

    device: ClassVar[str] = "tetractl_vw.actuator:VwActuator"
    calibration: ClassVar[str] = "tetractl.lab.calibrate:calibrate_robots"
    dead_zone_max: ClassVar[int] = 0
    type: Literal["vw"]
    rate: float = Field(default=20.0, ge=10, le=100)
    """Lines to each robot per second [Hz]."""
    delay: float = Field(default=0.01, ge=0, le=0.2)
    """Time from the sending of a line until the wheels follow it [s]."""
    speed_max_mm_s: float = Field(default=400.0, gt=0, le=5000)
    """Largest speed of a wheel [mm/s]."""
    robots: tuple[VwRobot, ...]

    def contradictions(self, setup):
        """Yield the problems with the spec."""
        yield from mismatches(self.robots, setup.names, ("address",))
        for i, robot in enumerate(self.robots):
            if address_of(robot.address) is None:
                yield ("robots", i, "address"), f"must be {SCHEME}HOST:PORT"

    def outputs(self, name, limit):
        """For `lab calibrate`: a 127th of the largest speed, and `limit` of them [mm/s]."""
        return self.speed_max_mm_s / 127, int(self.speed_max_mm_s * limit / 127)

    def measured(self, found):
        """For `lab calibrate`: a robot's fields in this section."""
        return found.gains(1.0)


class VwLinks(list):
    """The connections to all robots, as one."""

    @property
    def failure(self):
        """The reason why nothing can be sent any more."""
        return next((link.failure for link in self if link.failure), None)

    def open(self):
        """Open all."""
        for link in self:
            link.open()

    def close(self):
        """Close all."""
        for link in self:
            link.close()


class VwActuator(WheeledActuator):
    """A `tetractl.core.protocols.Actuator`; `ports` makes other ports, such as those in memory."""

    def __init__(self, section, setup, clock, ports=None):
        robots, make = [entry(section.robots, name) for name in setup.names], ports or open_port
        links = (make(r.address, 0, r.name, clock, lambda *_: None, HINT) for r in robots)
        own, self.links = [r.radius_mm for r in robots], VwLinks(links)
        self._gain = np.array([[r.left_gain, r.right_gain] for r in robots]).T
        self._radius = radii_mm(setup, own)
        wheels = drivetrains(self._gain, section.speed_max_mm_s)
        commands = WheelCommands(setup, clock, own, wheels, round(section.delay * SECOND))
        super().__init__(setup, self.links, lambda _: [], commands, section.rate, 0.0)

    def check(self):
        """Return nothing: a port that takes lines has nothing to report."""
        return Health()

    def poll(self, timeout_s):
        """Return that robots do not answer."""
        return [RobotStatus(answers=None) for _ in self.names]

    def stop(self, emergency=False):
        """Stop every robot."""
        count = len(self.names)
        return self._drive(Stop(), np.zeros((2, count), np.int64), (False,) * count)

    def _drive(self, action, outputs, moving):
        v, w = outputs.sum(axis=0) / 2000, (outputs[1] - outputs[0]) / (2 * self._radius)
        sent_ns, lost = 0, []
        for link, speed, turning in zip(self.links, v, w, strict=True):
            try:
                sent_ns = link.write(f"{speed:.4f} {turning:.4f}\n".encode())
            except AbortError as error:  # the other robots still get theirs
                lost.append(error)
        if lost:
            raise lost[0]
        return self._transmission(sent_ns, action, outputs * self._gain, moving)

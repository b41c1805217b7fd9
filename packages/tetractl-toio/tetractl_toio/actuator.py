"""An `Actuator` for toio cubes. Each motor command stops by itself after WATCHDOG_MS."""

from functools import partial

import numpy as np

from tetractl.core.clock import SECOND, Clock, wait_for
from tetractl.core.errors import AbortError
from tetractl.core.poses import Bools, Floats
from tetractl.core.protocols import Health, RobotStatus
from tetractl.core.setup import Setup
from tetractl.lab.actuators.wheel_commands import WheeledActuator, wheels_by_speed
from tetractl.lab.serial_port import PortFactory, PortGroup, stop_all_at
from tetractl.model.wheels import CountArray
from tetractl.spec.lab_section import entry
from tetractl_toio.cubes import BITS_PER_S, CONNECTION_HINT, CubesLink, make_port
from tetractl_toio.messages import (
    SPEED_MAX,
    SPEED_MIN,
    WHEEL_MM_S,
    Characteristic,
    encode_motor,
    pack,
)
from tetractl_toio.section import ToioSection

WATCHDOG_MS = 250
REQUESTS_MAX = 5  # number of questions: messages may be lost
CHARGE_MIN = 10  # charge below which a cube would soon stop [%]


class ToioActuator(WheeledActuator):
    """Drives toio cubes over Bluetooth; see `tetractl.core.protocols.Actuator`.

    Args:
        section: The actuator's section of the spec.
        setup: The constants of the experiment.
        clock: The clock for times.
        ports: Creates the port to a cube. None for the default.
    """

    def __init__(
        self, section: ToioSection, setup: Setup, clock: Clock, ports: PortFactory | None = None
    ) -> None:
        self.section = section
        robots = [entry(section.robots, name) for name in setup.names]
        self._charge: list[int | None] = [None] * len(robots)
        self.link = CubesLink(clock, [robot.cube for robot in robots], ports, self._receive)
        gain = np.array([[r.left_gain for r in robots], [r.right_gain for r in robots]])
        self._gain = gain * WHEEL_MM_S
        limit = min(section.speed_max_mm_s / WHEEL_MM_S, SPEED_MAX)
        self._limit = int(limit)
        self._owed = np.zeros_like(self._gain)  # what is left to be sent (2, N) [units]
        super().__init__(
            setup,
            clock,
            link=self.link,
            stated_radii_mm=[robot.radius_mm for robot in robots],
            drivetrains=wheels_by_speed(self._gain, limit),
            delay_ns=round(section.delay * SECOND),
            rate=section.rate,
        )

    def check(self) -> Health:
        """Report whether the cubes are emulated. It never reports a problem."""
        return Health(emulated=self.link.emulated)

    def outputs(self, wished: Floats, may_move: Bools) -> CountArray:
        """Convert wheel speeds to units of motor speed.

        A wheel does not turn below SPEED_MIN units. The part of a speed that whole units or the
        minimum speed cannot represent is carried over to the next command, so that the mean of the
        speeds sent is the wished speed.

        Args:
            wished: Wheel speeds, left and right, of N robots, shape (2, N) [mm/s].
            may_move: Whether each robot may move, shape (N,).

        Returns:
            The motor speeds, shape (2, N).
        """
        wished = wished * may_move
        exact_units = wished / self._gain
        exact_units /= np.maximum(1.0, np.abs(exact_units).max(axis=0) / self._limit)
        owed_total = exact_units + self._owed
        units = np.clip(np.rint(owed_total), -self._limit, self._limit)
        zero_or_minimum = np.where(
            np.abs(owed_total) < SPEED_MIN / 2, 0, np.copysign(SPEED_MIN, owed_total)
        )
        units = np.where(np.abs(units) < SPEED_MIN, zero_or_minimum, units)
        owed = np.clip(owed_total - units, -SPEED_MIN / 2, SPEED_MIN / 2)
        self._owed = owed * wished.any(axis=0)
        return units.astype(np.int64)

    def _halt(self, emergency: bool) -> int:
        """Stop every cube, and return the time at which the commands were sent [ns].

        Cubes have no emergency stop that persists, so `emergency` is ignored.
        """
        self._owed[:] = 0.0
        sent_ns, _ = self._drive(np.zeros_like(self._owed, dtype=np.int64))
        return sent_ns

    def poll(self, timeout_s: float) -> list[RobotStatus]:
        """Ask every cube for its battery charge, several times because messages can be lost.

        Args:
            timeout_s: Maximum time to wait for the answers [s].

        Returns:
            The status of each robot. It contains a problem if a cube did not answer or is almost
            empty, and a warning if its battery is low.
        """
        for _ in range(REQUESTS_MAX):
            for cube, charge in zip(self.link.cubes, self._charge, strict=True):
                if charge is None:
                    self.link.send(cube, Characteristic.BATTERY)
            if wait_for(self._clock, lambda: None not in self._charge, timeout_s / REQUESTS_MAX):
                break
        return [
            self._status(name, charge)
            for name, charge in zip(self.names, self._charge, strict=True)
        ]

    def _drive(self, outputs: CountArray) -> tuple[int, Floats]:
        """Send motor speeds (2, N) to all cubes, even if one of them cannot be reached.

        Returns:
            The time at which the last command was sent [ns], and the wheel speeds sent, shape (2,
            N) [mm/s].

        Raises:
            AbortError: If a cube could not be reached.
        """
        sent_ns = self._clock.now()
        lost = list[AbortError]()
        for cube, speeds in zip(self.link.cubes, outputs.T.tolist(), strict=True):
            command = encode_motor(speeds[0], speeds[1], WATCHDOG_MS)
            try:
                sent_ns = self.link.send(cube, Characteristic.MOTOR, command)
            except AbortError as error:  # the other cubes hear the stop
                lost.append(error)
        if lost:
            raise lost[0]
        return sent_ns, outputs * self._gain

    def _receive(self, i: int, characteristic: int, data: bytes, _at_ns: int) -> None:
        """Record the battery charge [%] of cube `i`. Other notifications are ignored."""
        if characteristic == Characteristic.BATTERY and len(data) == 1:
            self._charge[i] = data[0]

    def _status(self, name: str, charge: int | None) -> RobotStatus:
        """Describe a robot by its battery charge [%]. None means that its cube did not answer.

        No answer, and a charge below CHARGE_MIN, are problems. A charge below `battery_warn` is
        a warning.
        """
        if charge is None:
            return RobotStatus(
                False, problems=(f"{name} does not answer: is its cube switched on?",)
            )
        if charge < CHARGE_MIN:
            empty = (f"{name}'s battery is at {charge} %: charge it",)
            return RobotStatus(True, problems=empty, charge=charge)
        low = (f"{name}'s battery is at {charge} %",) if charge < self.section.battery_warn else ()
        return RobotStatus(True, warnings=low, charge=charge)


def stop_all(section: ToioSection, setup: Setup, clock: Clock, alone: bool) -> str:
    """Connect to each cube that can be reached, and stop it; see `ActuatorSection.stop_all`.

    Ten stop commands are sent within 200 ms, and then the cubes are disconnected. A cube does not
    keep the stop: a program that is connected to it can drive it again. The errors are those of
    `stop_all_at`.
    """
    links = PortGroup(
        make_port(robot.cube, BITS_PER_S, robot.name, clock, lambda *_: None, CONNECTION_HINT)
        for robot in section.robots
    )
    stop = pack(Characteristic.MOTOR, encode_motor(0, 0, WATCHDOG_MS))
    stops = [stop] * len(links.ports)
    return stop_all_at(links.ports, partial(links.send, stops), clock, alone)

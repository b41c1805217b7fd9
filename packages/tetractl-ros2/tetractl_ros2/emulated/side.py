"""Emulated robots of a ROS 2 graph, which follow twists and publish their battery states."""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, ClassVar

from tetractl_emulator.faults import ActingFaults, Fault
from tetractl_emulator.loop import Loop
from tetractl_emulator.m3pi.robot import EmulatedRobot
from tetractl_emulator.m3pi.wheeled_side import WHEELED_FAULTS, PortedSide, WheelsSettings
from tetractl_emulator.sides import Facts, Stage
from tetractl_emulator.twist.own_lines import DecodeMessage, OwnProgram, OwnRadio

from tetractl.core.clock import SECOND
from tetractl.core.protocols import EMULATED_NAME
from tetractl.lab.actuators.wheel_commands import Status
from tetractl.lab.serial_port import UNREADABLE
from tetractl.model.wheels import Counts
from tetractl_ros2.emulated.plug import on_topics
from tetractl_ros2.ros2_messages import BatteryState, Bool, Twist, Vector3, Vector3Stamped
from tetractl_ros2.section import Ros2Section
from tetractl_ros2.topics import COMMAND_MESSAGES, battery_topics, command_topics, emergency_topic

NETWORK_BAUD = 10_000_000
"""Speed of a slow wireless network [bits/s]."""
FULL_BATTERY_MV = 5100
"""Voltage of a full battery [mV]."""
EMPTY_BATTERY_MV = 4400
"""Voltage of an empty battery [mV]."""
BATTERY_PERIOD_NS = SECOND // 2
"""Time between two messages of a battery [ns]."""
NO_WATCHDOG_S = 1e6
"""Watchdog time of robots without a watchdog [s]: longer than any run."""
FAULTS_WITHOUT_MEANING = (
    *("baud", "bad_bytes", "overtaken_packets", "doubled_packets"),  # DDS numbers and checks
    *("stopped_elsewhere", "low_battery"),  # not every robot has these topics
)
"""Faults that a topic cannot have, or that not all robots can notice."""


class TwistProgram(OwnProgram):
    """The driver of a robot, which follows the newest twist until a watchdog or emergency stop.

    Args:
        decode: Decodes a message to the speeds of the left and the right wheel [unit_mm mm/s].
        watchdog_s: Time without a message after which the robot stops [s].
        battery_mv: Voltage of the battery [mV].

    Attributes:
        battery_mv: Voltage of the battery [mV].
        is_emergency_stopped: Whether the robot has received an emergency stop.
    """

    def __init__(self, decode: DecodeMessage, watchdog_s: float, battery_mv: int) -> None:
        super().__init__(decode, watchdog_s)
        self.battery_mv = battery_mv
        self.is_emergency_stopped = False

    def wheels(self, now_ms: int) -> Counts:
        """Return the present wheel speeds [unit_mm mm/s]. Both are 0 after an emergency stop."""
        return (0, 0) if self.is_emergency_stopped else super().wheels(now_ms)

    def status(self, now_ms: int) -> Status:
        """Return the robot's status flags.

        After an emergency stop, only EMERGENCY_STOPPED is set.
        """
        if self.is_emergency_stopped:
            return Status.EMERGENCY_STOPPED
        return super().status(now_ms)

    def set_battery(self, battery_mv: int) -> None:
        """Set the battery's voltage [mV]."""
        self.battery_mv = battery_mv


class EmergencyStop(OwnRadio):
    """The common topic of the emergency stop, which reaches the drivers of all robots."""

    def receive(self, data: bytes) -> None:
        """Stop all powered robots if the message of the emergency topic is True.

        A message that is False or cannot be decoded is ignored.
        """
        is_stop = False
        with suppress(*UNREADABLE):
            is_stop = Bool.deserialize(data).data
        if is_stop:
            for robot in self._decoder.robots:
                assert isinstance(robot.core, TwistProgram), "all robots run a TwistProgram"
                robot.core.is_emergency_stopped = robot.core.is_emergency_stopped or robot.powered

    def _record_commands(self, data: bytes) -> None:
        """Record nothing, because the record only contains commands that drive robots."""


class EmulatedRos2Robots(PortedSide):
    """Emulated robots that subscribe to the topics of a `Ros2Section`."""

    faults: ClassVar[Sequence[type[Fault]]] = tuple(
        kind for kind in WHEELED_FAULTS if kind.__name__ not in FAULTS_WITHOUT_MEANING
    )

    def __init__(self, stage: Stage, settings: WheelsSettings) -> None:
        section = stage.lab.actuator
        assert isinstance(section, Ros2Section), "the actuator's type is ros2"
        commands = command_topics(section, stage.setup, publishes=False)
        batteries = battery_topics(section, stage.setup, publishes=True)
        emergency = emergency_topic(section, publishes=False)
        topics = [topic for topic in (*commands, *batteries, emergency) if topic is not None]
        domain = section.domain
        stage = on_topics(stage, domain, topics)
        self._watchdog_s = section.stops_after or NO_WATCHDOG_S
        self._message = COMMAND_MESSAGES[section.message]
        self._setup = stage.setup
        super().__init__(
            stage, settings, (section.speed_max_mm_s / section.unit_mm, section.unit_mm)
        )
        self.radios = [
            OwnRadio(stage, topic.address(domain), self, row, settings.loss, NETWORK_BAUD)
            for row, topic in enumerate(commands)
        ]
        if emergency is not None:
            address = emergency.address(domain)
            self.radios.append(EmergencyStop(stage, address, self, 0, 0.0, NETWORK_BAUD))
        self._battery_ports = [
            None if topic is None else stage.wires.port(topic.address(domain))
            for topic in batteries
        ]

    def read(self, message: bytes, row: int) -> Counts:
        """Convert a command of the robot in a row to wheel speeds, left and right [unit_mm mm/s].

        The speeds are rounded to whole numbers and not limited.
        """
        decoded: Any = self._message.deserialize(message)
        if isinstance(decoded, Vector3Stamped):
            speed_mm_s, turning_rad_s = self._steer(decoded.vector, row)
        else:
            twist = decoded if isinstance(decoded, Twist) else decoded.twist
            speed_mm_s = twist.linear.x * 1000
            turning_rad_s = twist.angular.z
        wheel_offset_mm_s = turning_rad_s * float(self.radii[row])
        unit_mm = Ros2Section.unit_mm
        return round((speed_mm_s - wheel_offset_mm_s) / unit_mm), round(
            (speed_mm_s + wheel_offset_mm_s) / unit_mm
        )

    def _steer(self, vector: Vector3, row: int) -> tuple[float, float]:
        """Compute the speed [mm/s] and turning rate [rad/s] of a robot that steers itself.

        Both are 0 if the vector's x and y are 0. The speed is 0 if its z is not 0.
        """
        if not math.hypot(vector.x, vector.y):
            return 0.0, 0.0
        to_direction = math.atan2(vector.y, vector.x) - self.robots[row].heading
        speed = 0.0 if vector.z else float(self._setup.speed[row]) * self._setup.metres * 1000
        return speed, float(self._setup.a[row]) * math.sin(to_direction)

    def make_robot(
        self, row: int, name: str, battery_mv: int, acting: ActingFaults
    ) -> EmulatedRobot:
        """Create the robot in a row of the setup, with its driver; see `PortedSide.make_robot`."""
        make_program: Callable[[int], TwistProgram] = partial(self._make_program, battery_mv)
        return EmulatedRobot(name, row, battery_mv, make_program, acting)

    def _make_program(self, battery_mv: int, index: int) -> TwistProgram:
        read = partial(self.read, row=index)
        return TwistProgram(read, self._watchdog_s, battery_mv)

    def open(self, loop: Loop) -> Facts:
        """Join all topics, and start publishing the battery states."""
        facts = super().open(loop)
        for port in self._battery_ports:
            if port is not None:
                port.plug()
        self._publish_batteries()
        return facts

    def close(self) -> Facts:
        """Leave all topics."""
        for port in self._battery_ports:
            if port is not None:
                port.unplug()
        return super().close()

    def _publish_batteries(self) -> None:
        """Publish the battery state of each powered robot, and schedule the next time."""
        for robot, port in zip(self.robots, self._battery_ports, strict=True):
            if port is not None and robot.powered:
                assert isinstance(robot.core, TwistProgram), "all robots run a TwistProgram"
                port.write(_battery_state(robot.core.battery_mv).serialize())
        self.timeline.at(self.timeline.now_ns + BATTERY_PERIOD_NS, self._publish_batteries)


def _battery_state(battery_mv: int) -> BatteryState:
    charge_fraction = (battery_mv - EMPTY_BATTERY_MV) / (FULL_BATTERY_MV - EMPTY_BATTERY_MV)
    return BatteryState(
        voltage=battery_mv / 1000,
        percentage=max(0.0, min(1.0, charge_fraction)),
        serial_number=EMULATED_NAME,
    )

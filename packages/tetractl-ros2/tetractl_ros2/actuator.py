"""Drives robots of a ROS 2 graph: one twist for each robot, and a common emergency stop.

A twist consists of a speed v and a turning rate w. For a robot whose two wheels are at a distance r
from its centre, it means the wheel speeds

    left = v - r w,    right = v + r w.

The counts of the base class `WheeledActuator` are wheel speeds in units of the section's `unit_mm`.
Robots that steer themselves receive the direction instead of a twist. Their wheel speeds are
computed from this direction, the spec's values and the latest measured pose.
"""

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial

from tetractl.core.clock import SECOND, Clock, wait_for
from tetractl.core.commands import Steer, Transmission, Turn
from tetractl.core.poses import Floats, Pose
from tetractl.core.protocols import EMULATED_NAME, Health, RobotStatus
from tetractl.core.setup import Setup
from tetractl.lab.actuators.own_robots import SpeedRobots
from tetractl.lab.serial_port import UNREADABLE, PortFactory, PortGroup, SerialPort, stop_all_at
from tetractl.model.wheels import CountArray
from tetractl.spec.lab_section import entry
from tetractl_ros2.ros2_messages import (
    BatteryState,
    Bool,
    Header,
    Time,
    Twist,
    TwistStamped,
    Vector3,
    Vector3Stamped,
)
from tetractl_ros2.section import DIRECTION, Ros2Section
from tetractl_ros2.topic_port import TopicPort, ports_of
from tetractl_ros2.topics import battery_topics, command_topics, emergency_topic

BASE_FRAME = "base_link"
"""Frame of a TwistStamped, which is the robot's own frame."""
WORLD_FRAME = "world"
"""Frame of a direction, which has the axes of the spec."""
EMPTY_PERCENT = 10.0
"""Charge below which a robot would soon stop [%]."""
DRIVER_HINT = "is the robot's driver running, and in the same ROS domain?"
NO_WATCHDOG = (
    "`stops_after` is not set: if this computer or its network fails, the robots drive on "
    "with their last command until somebody switches them off"
)


class Ros2Robots(SpeedRobots):
    """The actuator that drives robots of a ROS 2 graph; see `tetractl.core.protocols.Actuator`.

    Args:
        section: The actuator's section of the spec.
        setup: The constants of the experiment.
        clock: The run's clock.
        ports: Creates ports instead of the default ones, for example ports in memory.
        unix_ns: Returns the time since 1970 [ns], for the stamps of TwistStamped.
    """

    def __init__(
        self,
        section: Ros2Section,
        setup: Setup,
        clock: Clock,
        ports: PortFactory | None = None,
        unix_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self.section = section
        self._unix_ns = unix_ns
        self._direction_vector = Vector3()  # of the newest direction or turn
        self._batteries: list[BatteryState | None] = [None] * len(setup.names)
        commands = command_topics(section, setup)
        batteries = battery_topics(section, setup)
        emergency = emergency_topic(section)
        topics = [topic for topic in (*commands, *batteries, emergency) if topic is not None]
        make_port = ports or ports_of(topics)
        domain = section.domain
        self._command_ports = [
            make_port(topic.address(domain), 0, name, clock, lambda *_: None, DRIVER_HINT)
            for name, topic in zip(setup.names, commands, strict=True)
        ]
        battery_ports = [
            make_port(
                topic.address(domain),
                0,
                topic.name,
                clock,
                partial(self._receive_battery, row),
                DRIVER_HINT,
            )
            for row, topic in enumerate(batteries)
            if topic is not None
        ]
        self._emergency_port: SerialPort | None = None
        if emergency is not None:
            address = emergency.address(domain)
            self._emergency_port = make_port(
                address, 0, "the emergency stop", clock, lambda *_: None, DRIVER_HINT
            )
        emergency_ports = [] if self._emergency_port is None else [self._emergency_port]
        all_ports = PortGroup([*self._command_ports, *emergency_ports, *battery_ports])
        robots = [entry(section.robots, name) for name in setup.names]
        super().__init__(section, robots, setup, clock, all_ports)

    @property
    def stopping_ports(self) -> list[SerialPort]:
        """The ports for stopping the robots: the command ports, then the emergency stop's port."""
        emergency = [] if self._emergency_port is None else [self._emergency_port]
        return [*self._command_ports, *emergency]

    def check(self) -> Health:
        """Check for other nodes that drive the robots, and for an unheard emergency stop.

        An emergency stop is unheard if no node subscribes to its topic. If the section does not
        state a watchdog, the result also asks the user about it.
        """
        problems = [
            (
                f"{n_others} other publisher{'s' * (n_others > 1)} on {port.end.topic.name}: stop "
                "the other programs that drive this robot"
            )
            for port in self._command_ports
            if isinstance(port, TopicPort) and (n_others := port.end.count_other_publishers()) > 0
        ]
        emergency_port = self._emergency_port
        if isinstance(emergency_port, TopicPort) and not emergency_port.look_for_subscribers():
            problems.append(
                "the emergency stop does not reach any robot: "
                f"{emergency_port.refusal}: {DRIVER_HINT}"
            )
        questions = () if self.section.stops_after is not None else (NO_WATCHDOG,)
        is_emulated = any(
            state is not None and state.serial_number == EMULATED_NAME for state in self._batteries
        )
        return Health(tuple(problems), questions=questions, emulated=is_emulated)

    def poll(self, timeout_s: float) -> list[RobotStatus]:
        """Wait for the battery states, and return the status of each robot.

        The method does not wait for robots without a battery topic. The status also reports a robot
        whose command topic has no subscriber.

        Args:
            timeout_s: Maximum time to wait [s].
        """
        has_battery = [entry(self.section.robots, name).battery is not None for name in self.names]

        def has_all_states() -> bool:
            pairs = zip(has_battery, self._batteries, strict=True)
            return all(state is not None for expected, state in pairs if expected)

        wait_for(self._clock, has_all_states, timeout_s)
        return [self._status(row, has_battery[row]) for row in range(len(self.names))]

    def _status(self, row: int, has_battery: bool) -> RobotStatus:
        """Describe a robot's link and battery, with a warning if an expected state is missing."""
        name = self.names[row]
        port = self._command_ports[row]
        has_subscriber = port.look_for_subscribers() if isinstance(port, TopicPort) else None
        problems = () if port.refusal is None else (f"{name}: {port.refusal}: {DRIVER_HINT}",)
        state = self._batteries[row]
        if state is None:
            silence_warning = (
                f"{name} sends no battery state on the topic "
                f"{entry(self.section.robots, name).battery}"
            )
            return RobotStatus(
                has_subscriber, problems=problems, warnings=(silence_warning,) * has_battery
            )
        voltage = state.voltage if math.isfinite(state.voltage) else None
        charge_percent = round(100 * state.percentage) if math.isfinite(state.percentage) else None
        low_battery_text = f"{name}'s battery is at {charge_percent} %"
        if charge_percent is not None and charge_percent < EMPTY_PERCENT:
            problems = (*problems, f"{low_battery_text}: charge it")
        is_low = (
            charge_percent is not None
            and EMPTY_PERCENT <= charge_percent < self.section.battery_warn
        )
        return RobotStatus(
            has_subscriber, voltage, problems, (low_battery_text,) * is_low, charge_percent
        )

    def send(
        self,
        action: Steer | Turn,
        poses: Sequence[Pose | None],
        moving: Sequence[bool],
        exposed_ns: int,
    ) -> Transmission:
        """Send each robot its command; see `tetractl.core.protocols.Actuator.send`."""
        self._direction_vector = _direction_vector(action)
        return super().send(action, poses, moving, exposed_ns)

    def command(self, row: int, left: float, right: float) -> bytes:
        """Create the message that commands a robot's wheel speeds.

        A robot that steers itself receives the common direction instead, or the zero vector if both
        wheel speeds are 0.

        Args:
            row: The robot's index in the setup.
            left: Speed of the left wheel [mm/s].
            right: Speed of the right wheel [mm/s].
        """
        if self.section.message == DIRECTION:
            vector = self._direction_vector if left or right else Vector3()
            return Vector3Stamped(header=self._header(WORLD_FRAME), vector=vector).serialize()
        speed_m_s = (left + right) / 2000
        turning_rad_s = (right - left) / (2 * float(self.radii[row]))
        message = Twist(linear=Vector3(x=speed_m_s), angular=Vector3(z=turning_rad_s))
        if self.section.message == "Twist":
            return message.serialize()
        return TwistStamped(header=self._header(BASE_FRAME), twist=message).serialize()

    def _header(self, frame: str) -> Header:
        """Create a message header with the present time and a coordinate frame."""
        sec, nanosec = divmod(self._unix_ns(), SECOND)
        return Header(stamp=Time(sec, nanosec), frame_id=frame)

    def _drive(self, outputs: CountArray) -> tuple[int, Floats]:
        """Send wheel speeds [unit_mm mm/s] to all robots; see the base class."""
        speeds_mm_s = outputs * self.section.unit_mm
        messages = [self.command(row, *pair) for row, pair in enumerate(speeds_mm_s.T.tolist())]
        return self._send(self._command_ports, messages), outputs * self.gain

    def _halt(self, emergency: bool) -> int:
        """Stop all robots, and also send the emergency stop if `emergency`; see the base class."""
        messages = [self.command(row, 0.0, 0.0) for row in range(len(self.names))]
        ports = self._command_ports
        if emergency and self._emergency_port is not None:
            ports = [*ports, self._emergency_port]
            messages.append(Bool(data=True).serialize())
        return self._send(ports, messages)

    def _send(self, ports: list[SerialPort], messages: list[bytes]) -> int:
        """Send each port its message, even if another port fails, and return the last time [ns].

        Raises:
            AbortError: If a port has failed.
        """
        return PortGroup(ports).send(messages)

    def _receive_battery(self, row: int, data: bytes, _at_ns: int) -> None:
        """Keep a robot's newest battery state. A message that cannot be decoded is ignored."""
        if data:  # otherwise the port has failed
            with suppress(*UNREADABLE):
                self._batteries[row] = BatteryState.deserialize(data)


def _direction_vector(action: Steer | Turn) -> Vector3:
    """Create the vector message (cos u, sin u, z) of a direction u.

    z is 1 if the robots should turn on the spot, and 0 if they should drive.
    """
    if isinstance(action, Steer):
        return Vector3(math.cos(action.direction), math.sin(action.direction), 0.0)
    return Vector3(math.cos(action.facing), math.sin(action.facing), 1.0)


def stop_all(section: Ros2Section, setup: Setup, clock: Clock, alone: bool) -> str:
    """Stop every robot with ten messages within 200 ms, and return a summary.

    If some topics have no subscriber, the function waits for subscribers for up to DISCOVERY_S, and
    meanwhile sends further stops to the other robots.

    Args:
        section: The actuator's section of the spec.
        setup: The constants of the experiment.
        clock: The clock for times.
        alone: Whether to open the topics exclusively.

    Raises:
        AbortError: If a robot's topic has no subscriber. The other robots are stopped.
    """
    robots = Ros2Robots(section, setup, clock)
    return stop_all_at(robots.stopping_ports, partial(robots.stop, emergency=True), clock, alone)

"""An emulated cube: the program that it runs, and its Bluetooth connection. No I/O happens here.

A Bluetooth connection transfers data only at its connection events, which follow each other at a
fixed interval. At each event, the cube receives what was written since the previous event, and
sends its notifications. Whether the program of a real cube does the same is not known.
"""

from collections.abc import Sequence
from typing import Any

from tetractl_emulator.m3pi.robot import EmulatedRobot
from tetractl_emulator.m3pi.robot_radio import RobotRadio
from tetractl_emulator.port import PseudoPort
from tetractl_emulator.sides import Stage

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.core.errors import WireError
from tetractl.core.protocols import EMULATED_NAME
from tetractl.lab.actuators.wheel_commands import Status
from tetractl.model.wheels import Counts
from tetractl_toio.cubes import BITS_PER_S
from tetractl_toio.messages import SPEED_MIN, Characteristic, Unpacker, decode_motor, pack

RUN_FLAG = 1
"""Flag in the record of a command that turns a motor."""
STOP_FLAG = 2
"""Flag in the record of a command that stops both motors. A cube has no other kind of stop."""
BATTERY_EMPTY_MV = 4400
"""Voltage of the emulated battery when it is empty [mV]. This value is a guess."""
BATTERY_FULL_MV = 5100
"""Voltage of the emulated battery when it is full [mV]. This value is a guess."""


READING_SETTINGS = (b"\x18", b"\x19")
"""First bytes of the settings that determine when a cube notifies its reading of the mat."""


class CubeProgram:
    """The program that runs in an emulated cube: it drives the motors, and answers messages."""

    def __init__(self, _index: int = 0) -> None:
        self._unpacker = Unpacker()
        self._answers = b""
        self._motor_speeds: Counts = (0, 0)
        self._command_end_ms: int | None = None
        self._is_silent = True  # no command acts, because the last command ended by itself
        self.is_notifying = False  # the cube reports each reading
        self.is_reading_requested = False  # a program has asked for one reading
        self.charge_percent = 100

    def push(self, data: bytes, now_ms: int) -> None:
        """Process received messages. Invalid messages are ignored, as a real cube does."""
        for characteristic, payload in self._unpacker.feed(data):
            if characteristic == Characteristic.MOTOR:
                self._execute_motor_command(payload, now_ms)
            elif characteristic == Characteristic.ID and not payload:
                self.is_reading_requested = True
            elif characteristic == Characteristic.BATTERY and not payload:
                self._answers += pack(Characteristic.BATTERY, bytes([self.charge_percent]))
            elif characteristic == Characteristic.CONFIGURATION:
                self._configure(payload)

    def _configure(self, payload: bytes) -> None:
        """Switch on notifications of readings, and acknowledge the setting.

        All other settings are ignored.
        """
        if payload[:1] not in READING_SETTINGS:
            return
        self.is_notifying = True
        acknowledgement = bytes([0x80 | payload[0], 0, 0])
        self._answers += pack(Characteristic.EMULATED, EMULATED_NAME.encode())
        self._answers += pack(Characteristic.CONFIGURATION, acknowledgement)

    def wheels(self, now_ms: int) -> Counts:
        """Return the present speeds of the left and the right motor.

        The speeds are 0 after the duration of the last command.
        """
        if self._command_end_ms is not None and now_ms >= self._command_end_ms:
            self._motor_speeds = (0, 0)
            self._command_end_ms = None
            self._is_silent = True
        return self._motor_speeds

    def status(self, now_ms: int) -> Status:
        """Return the status of the motors.

        Returns:
            RUNNING if a motor turns. SILENT if the last command has ended by itself. 0 otherwise.
        """
        is_running = any(self.wheels(now_ms))
        if self._is_silent:
            return Status.SILENT
        return Status.RUNNING if is_running else Status(0)

    def take_reply(self, now_ms: int) -> bytes:
        """Return the packed answers since the last call. Empty if there are no answers."""
        answers = self._answers
        self._answers = b""
        return answers

    def set_battery(self, battery_mv: int) -> None:
        """Compute the battery's charge from its voltage [mV], in steps of 10 % from 0 to 100 %."""
        fraction = (battery_mv - BATTERY_EMPTY_MV) / (BATTERY_FULL_MV - BATTERY_EMPTY_MV)
        self.charge_percent = max(0, min(100, 10 * round(10 * fraction)))

    def _execute_motor_command(self, payload: bytes, now_ms: int) -> None:
        """Execute a motor command, which ends after its duration. A duration of 0 never ends.

        An invalid command is ignored.
        """
        try:
            command = decode_motor(payload)
        except WireError:
            return
        self._motor_speeds = (
            _compute_turning_speed(command.left),
            _compute_turning_speed(command.right),
        )
        self._is_silent = False
        self._command_end_ms = now_ms + command.duration_ms if command.duration_ms else None


def _compute_turning_speed(speed: int) -> int:
    """Compute the speed at which a motor turns for a commanded speed: 0 below SPEED_MIN."""
    return speed if abs(speed) >= SPEED_MIN else 0


class Connection(RobotRadio):
    """The Bluetooth connection to one emulated cube.

    Data is transferred at connection events, and each transfer can be lost or late.

    Args:
        stage: The data and functions that the emulated devices share.
        port: The port at which a program reaches the cube.
        robot: The cube.
        robots: All cubes of the setup, in order. The record of a command has an entry for each
            cube, although only `robot` receives the command.
        interval_ns: Time between two connection events [ns].
        phase_ns: Time from now until the first event [ns].
        loss: Probability that a transfer is lost.
        seed: Seed of the random numbers that decide which transfers are lost or late.
    """

    def __init__(
        self,
        stage: Stage,
        port: PseudoPort,
        robot: EmulatedRobot,
        robots: Sequence[EmulatedRobot],
        interval_ns: int,
        phase_ns: int,
        loss: float,
        seed: int,
    ) -> None:
        super().__init__(
            stage.timeline, port, BITS_PER_S, stage.note, [robot], loss, seed, stage.acting
        )
        self.robot = robot
        self._robots = robots
        self._interval_ns = interval_ns
        self._written_data = list[bytes]()
        self._notifications = list[tuple[bytes, Any]]()
        self._record_unpacker = Unpacker()
        self._last_delivery_ns = 0
        self._timeline.at(self._timeline.now_ns + phase_ns, self._exchange)

    def receive(self, data: bytes) -> None:
        """Queue bytes that a program has written.

        The cube receives them at the next connection event.
        """
        self._written_data += [data] * self.times

    def notify(self, message: bytes, on_sent: Any) -> None:
        """Queue a reading of the cube, which is sent at the next connection event.

        Args:
            message: The packed notification.
            on_sent: Called without arguments when this reading is sent. It is not called if the
                reading is lost, or if a newer reading is sent at the same event.
        """
        self._notifications.append((message, on_sent))

    def poll_answers(self) -> None:
        """Do nothing: answers are sent at the connection events."""

    def _exchange(self) -> None:
        """Transfer the waiting data in both directions, and schedule the next connection event."""
        written_data = self._written_data
        self._written_data = []
        notifications = self._notifications
        self._notifications = []
        random = self._random
        now_ns = self._timeline.now_ns
        for data in written_data:
            if random.random() >= self.loss_probability(self.robot.name):
                # a connection keeps the order of its messages
                delay_ns = self.sample_delay_ns() + self.robot.late_ns
                self._last_delivery_ns = max(self._last_delivery_ns, now_ns + delay_ns)
                self._timeline.at(
                    self._last_delivery_ns, lambda data=data: self.robot.receive(data)
                )
        if self.port.fd >= 0 and not self.is_down and self.robot.powered:
            delivered_notifications = [
                notification
                for notification in notifications
                if random.random() >= self.loss_probability()
            ]
            data = b"".join(message for message, _ in delivered_notifications) + self.robot.answer()
            if data:
                self.port.write(data)
            if delivered_notifications:  # only the newest reading of an event counts
                _, on_sent = delivered_notifications[-1]
                on_sent()
        self._timeline.at(now_ns + self._interval_ns, self._exchange)

    def _decode_command(self, frame: bytes) -> dict[str, Any]:
        """Describe a motor command for the record: its flags, its speeds and the driven robots."""
        command = decode_motor(frame)
        motors = [command.left, command.right]
        is_running = any(motors)
        is_driven = [is_running and robot is self.robot for robot in self._robots]
        return {
            "flags": RUN_FLAG if is_running else STOP_FLAG,
            "motors": motors,
            "drives": is_driven,
        }

    def _record_commands(self, data: bytes) -> None:
        """Record the motor commands that a program has written, even if they are lost later."""
        for characteristic, payload in self._record_unpacker.feed(data):
            if characteristic == Characteristic.MOTOR:
                self._record_frames([payload])


def to_whole_ms_ns(seconds: float) -> int:
    """Convert a time [s] to ns, rounded to whole milliseconds."""
    return round(seconds * SECOND / MILLISECOND) * MILLISECOND

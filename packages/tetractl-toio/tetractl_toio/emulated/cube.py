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
from tetractl_toio.cubes import SPEED
from tetractl_toio.messages import SPEED_MIN, Characteristic, Unpacker, decode_motor, pack

RUN = 1
"""Flag of a command in the record that turns a motor."""
STOP = 2
"""Flag of a command in the record that stops both motors. A cube has no other kind of stop."""
EMPTY_MV = 4400
"""Voltage of the emulated battery when it is empty [mV]. It is a guess."""
FULL_MV = 5100
"""Voltage of the emulated battery when it is full [mV]. It is a guess."""


READING_SETTINGS = (b"\x18", b"\x19")
"""First bytes of the settings that say when a cube notifies its reading."""


class CubeProgram:
    """The program of a cube: it receives motor commands and settings, and drives the motors."""

    def __init__(self, _index: int = 0) -> None:
        self._unpacker = Unpacker()
        self._answers = b""
        self._speeds: Counts = (0, 0)
        self._ends_ms: int | None = None
        self._is_silent = True  # no command acts, because the last one ended by itself
        self.is_notifying = False  # the cube reports each reading
        self.is_asked = False  # a program has asked for one reading
        self.charge = 100

    def push(self, data: bytes, now_ms: int) -> None:
        """Process received messages. Invalid messages are ignored, as a real cube does."""
        for characteristic, payload in self._unpacker.feed(data):
            if characteristic == Characteristic.MOTOR:
                self._run_motors(payload, now_ms)
            elif characteristic == Characteristic.ID and not payload:
                self.is_asked = True
            elif characteristic == Characteristic.BATTERY and not payload:
                self._answers += pack(Characteristic.BATTERY, bytes([self.charge]))
            elif characteristic == Characteristic.CONFIGURATION:
                self._configure(payload)

    def _configure(self, payload: bytes) -> None:
        """Process a setting that switches notifications of readings on, and acknowledge it.

        All other settings are ignored.
        """
        if payload[:1] not in READING_SETTINGS:
            return
        self.is_notifying = True
        is_set = bytes([0x80 | payload[0], 0, 0])
        self._answers += pack(Characteristic.EMULATED, EMULATED_NAME.encode())
        self._answers += pack(Characteristic.CONFIGURATION, is_set)

    def wheels(self, now_ms: int) -> Counts:
        """Return the present speeds of the left and the right motor.

        They are 0 after the duration of the last command.
        """
        if self._ends_ms is not None and now_ms >= self._ends_ms:
            self._speeds = (0, 0)
            self._ends_ms = None
            self._is_silent = True
        return self._speeds

    def status(self, now_ms: int) -> Status:
        """Return the status of the motors.

        Returns:
            RUNNING if a motor turns, SILENT if the last command has ended by itself, and otherwise
            0.
        """
        running = any(self.wheels(now_ms))
        if self._is_silent:
            return Status.SILENT
        return Status.RUNNING if running else Status(0)

    def take_reply(self, now_ms: int) -> bytes:
        """Return the packed answers since the last call.

        The result is empty if there are no answers.
        """
        answers = self._answers
        self._answers = b""
        return answers

    def set_battery(self, battery_mv: int) -> None:
        """Set the battery's charge from its voltage [mV], in steps of 10 % from 0 to 100 %."""
        fraction = (battery_mv - EMPTY_MV) / (FULL_MV - EMPTY_MV)
        self.charge = max(0, min(100, 10 * round(10 * fraction)))

    def _run_motors(self, payload: bytes, now_ms: int) -> None:
        """Execute a motor command, which ends after its duration [ms] or never if that is 0.

        An invalid command is ignored.
        """
        try:
            command = decode_motor(payload)
        except WireError:
            return
        self._speeds = (_turning_speed(command.left), _turning_speed(command.right))
        self._is_silent = False
        self._ends_ms = now_ms + command.duration_ms if command.duration_ms else None


def _turning_speed(speed: int) -> int:
    """Return the speed at which a motor turns for a commanded speed: 0 below SPEED_MIN."""
    return speed if abs(speed) >= SPEED_MIN else 0


class Connection(RobotRadio):
    """The Bluetooth connection to one emulated cube.

    Data is transferred at connection events, and each transfer can be lost or late.

    Args:
        stage: The data and functions that the emulated devices share.
        port: The port at which a program reaches the cube.
        robot: The cube.
        robots: All cubes of the setup, in order. The record of a command has an entry for each,
            though only `robot` receives the command.
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
        super().__init__(stage.timeline, port, SPEED, stage.note, [robot], loss, seed, stage.acting)
        self.robot = robot
        self._robots = robots
        self._interval_ns = interval_ns
        self._written = list[bytes]()
        self._notifications = list[tuple[bytes, Any]]()
        self._record_unpacker = Unpacker()
        self._received_ns = 0
        self._timeline.at(self._timeline.now_ns + phase_ns, self._exchange)

    def receive(self, data: bytes) -> None:
        """Queue bytes that a program has written.

        The cube receives them at the next connection event.
        """
        self._written += [data] * self.times

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
        written = self._written
        self._written = []
        notifications = self._notifications
        self._notifications = []
        random = self._random
        now_ns = self._timeline.now_ns
        for data in written:
            if random.random() >= self.loss_probability(self.robot.name):
                # a connection keeps the order of what it passes on
                delay_ns = self.sample_delay_ns() + self.robot.late_ns
                self._received_ns = max(self._received_ns, now_ns + delay_ns)
                self._timeline.at(self._received_ns, lambda data=data: self.robot.receive(data))
        if self.port.fd >= 0 and not self.is_down and self.robot.powered:
            delivered = [
                note for note in notifications if random.random() >= self.loss_probability()
            ]
            data = b"".join(message for message, _ in delivered) + self.robot.answer()
            if data:
                self.port.write(data)
            if delivered:  # only the newest reading of an event counts
                _, on_sent = delivered[-1]
                on_sent()
        self._timeline.at(now_ns + self._interval_ns, self._exchange)

    def _decode_command(self, frame: bytes) -> dict[str, Any]:
        """Describe a motor command for the record: its flags, motor speeds and driven robots."""
        command = decode_motor(frame)
        motors = [command.left, command.right]
        runs = any(motors)
        drives = [runs and robot is self.robot for robot in self._robots]
        return {"flags": RUN if runs else STOP, "motors": motors, "drives": drives}

    def _record_commands(self, data: bytes) -> None:
        """Record the motor commands that a program has written, even if they are lost later."""
        for characteristic, payload in self._record_unpacker.feed(data):
            if characteristic == Characteristic.MOTOR:
                self._record_frames([payload])


def ns(seconds: float) -> int:
    """Round a time [s] to whole milliseconds, and return it in ns."""
    return round(seconds * SECOND / MILLISECOND) * MILLISECOND

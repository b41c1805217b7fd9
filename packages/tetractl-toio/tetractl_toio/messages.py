"""Encodes and decodes the messages of a toio cube, and packs them for a port.

A cube has characteristics that can be written, read or notify. Integers are little-endian. Source:
toio Core Cube Specification 2.4.0,
https://toio.github.io/toio-spec/en/docs/ble_communication_overview.
"""

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from tetractl.core.errors import WireError

SERVICE = "10b20100-5b3b-4571-9508-cf3efcd7bbae"
SPEED_MAX = 115
"""Maximum motor speed that a cube accepts."""
SPEED_MIN = 8
"""Minimum motor speed at which its wheels turn."""
WHEEL_MM_S = 4.3 / 60 * math.pi * 12.5
"""Speed of a wheel of 12.5 mm for one unit of motor speed, 4.3 revolutions a minute [mm/s]."""
RADIUS_MM = 13.3
"""Distance from a wheel to the cube's centre [mm]: its wheels are 26.6 mm apart."""
MAT_MM = 1.36
"""Length of a unit of the mat's coordinates [mm]."""
SAME_EVENT_S = 0.003
"""Maximum time between messages of the same connection event [s].

Connection events are 7.5 ms apart.
"""
ON_MAT = 0x01
"""First byte of a notification of a position on the mat."""
NO_MAT = 0x03
"""First byte of a notification that the cube sees no mat."""
LEFT_MOTOR = 1
"""Number of the left motor in a motor command."""
RIGHT_MOTOR = 2
"""Number of the right motor in a motor command."""
FORWARD = 1
"""Value of a motor's direction in a motor command for driving forward."""
BACKWARD = 2
"""Value of a motor's direction in a motor command for driving backward."""
DURATION_MS = 10
"""Unit of the duration of a motor command, and of the interval of notifications [ms]."""
NOTIFY_READINGS = bytes([0x18, 0, 1, 0])
"""The setting that makes a cube notify its reading each DURATION_MS, changed or not."""
NOTIFY_MISSED = bytes([0x19, 0, 1])
"""The setting that makes a cube report that it is off the mat, after DURATION_MS off the mat."""


class Characteristic(IntEnum):
    """A cube's characteristic: the part of its UUID that differs from the service's UUID."""

    EMULATED = 0x00  # a real cube does not have it; an emulated cube notifies its name
    ID = 0x01
    MOTOR = 0x02
    BATTERY = 0x08
    CONFIGURATION = 0xFF

    @property
    def uuid(self) -> str:
        """The full UUID of the characteristic."""
        return f"{SERVICE[:6]}{self:02x}{SERVICE[8:]}"


@dataclass(frozen=True, slots=True)
class CubeReading:
    """The position and angle that a cube reads from the mat.

    Attributes:
        x: x of the cube's centre, in the mat's units.
        y: y of the cube's centre, in the mat's units. The axis points down.
        angle: Direction of the cube [degrees]: 0 along x, clockwise.
    """

    x: int
    y: int
    angle: int


class MotorCommand(NamedTuple):
    """A command to both motors of a cube.

    Attributes:
        left: Speed of the left motor. Negative for backward.
        right: Speed of the right motor. Negative for backward.
        duration_ms: Time after which the cube stops its motors [ms]. 0 for never.
    """

    left: int
    right: int
    duration_ms: int


def decode_reading(data: bytes) -> CubeReading | None:
    """Decode a notification of the characteristic `ID`.

    Returns:
        The reading. None if the cube sees no mat, or sees a card instead.

    Raises:
        WireError: If the data is not such a notification.
    """
    if len(data) == 13 and data[0] == ON_MAT:
        x, y, angle = struct.unpack_from("<HHH", data, 1)
        if angle <= 360:
            return CubeReading(x, y, angle)
    elif (len(data), data[:1]) in ((1, b"\x03"), (1, b"\x04"), (7, b"\x02")):
        return None
    raise WireError(f"these bytes are not a reading of the mat: {data.hex()}")


def encode_reading(reading: CubeReading | None) -> bytes:
    """Encode the notification of a reading. None stands for a cube that sees no mat.

    A real notification also contains the position of the sensor. Here it equals the centre.
    """
    if reading is None:
        return bytes([NO_MAT])
    position = (reading.x, reading.y, reading.angle)
    return struct.pack("<BHHHHHH", ON_MAT, *position, *position)


def encode_motor(left_speed: int, right_speed: int, duration_ms: int) -> bytes:
    """Encode a command that drives both motors for a limited time.

    Args:
        left_speed: Speed of the left motor, within SPEED_MAX. Negative for backward.
        right_speed: Speed of the right motor, within SPEED_MAX. Negative for backward.
        duration_ms: Time after which the cube stops its motors, from 10 to 2550 [ms].

    Raises:
        ValueError: If a speed or the duration is out of range.
    """
    is_too_fast = max(abs(left_speed), abs(right_speed)) > SPEED_MAX
    if is_too_fast or not 10 <= duration_ms <= 2550:
        raise ValueError(
            f"motor speeds {left_speed}, {right_speed} for {duration_ms} ms are out of range"
        )
    motors = (
        *_encode_motor_values(LEFT_MOTOR, left_speed),
        *_encode_motor_values(RIGHT_MOTOR, right_speed),
    )
    return bytes([0x02, *motors, duration_ms // DURATION_MS])


def _encode_motor_values(motor: int, speed: int) -> tuple[int, int, int]:
    """Return the three values that command one motor: its number, direction and absolute speed.

    A speed of 0 has the direction FORWARD.
    """
    return motor, FORWARD if speed >= 0 else BACKWARD, abs(speed)


def decode_motor(data: bytes) -> MotorCommand:
    """Decode a motor command.

    Raises:
        WireError: If a cube would ignore the data, because its length or a value is invalid, or
            because it contains the same motor twice.
    """
    if (len(data), data[:1]) not in ((8, b"\x02"), (7, b"\x01")):
        raise WireError(f"these bytes are not a motor command: {data.hex()}")
    speeds: dict[int, int] = {}
    for motor, direction, absolute_speed in (data[1:4], data[4:7]):
        is_motor = motor in (LEFT_MOTOR, RIGHT_MOTOR) and motor not in speeds
        if not is_motor or direction not in (FORWARD, BACKWARD):
            raise WireError(f"a cube would ignore this motor command: {data.hex()}")
        speeds[motor] = absolute_speed if direction == FORWARD else -absolute_speed
    duration_ms = DURATION_MS * data[7] if len(data) == 8 else 0
    return MotorCommand(speeds[LEFT_MOTOR], speeds[RIGHT_MOTOR], duration_ms)


def is_refusal(data: bytes) -> bool:
    """Check whether a notification of `CONFIGURATION` reports that the cube refused a setting.

    Only the settings of NOTIFY_READINGS and NOTIFY_MISSED are considered.
    """
    return len(data) == 3 and data[0] in (0x98, 0x99) and data[2] != 0


def pack(characteristic: Characteristic, data: bytes = b"") -> bytes:
    """Pack a message for a port: the characteristic, the number of data bytes, and the data.

    A message without data asks the cube for the present value of the characteristic.
    """
    return bytes([characteristic, len(data)]) + data


class Unpacker:
    """Splits the byte stream of a port into messages. It is the inverse of `pack`."""

    def __init__(self) -> None:
        self._unfinished = b""

    def feed(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Add received bytes, and yield characteristic and data of each complete message.

        Bytes of an incomplete message are kept for the next call.
        """
        self._unfinished += data
        while len(self._unfinished) >= 2 and len(self._unfinished) >= 2 + self._unfinished[1]:
            message_end = 2 + self._unfinished[1]
            message = self._unfinished[:message_end]
            self._unfinished = self._unfinished[message_end:]
            yield message[0], message[2:]

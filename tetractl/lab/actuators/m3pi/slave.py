"""The bytes of the 3pi's own serial-slave program, which runs without an mbed.

Bytes from 0x80 on are commands, others their data. **This program has no watchdog**: without
commands the motors run on. A lost data byte leaves the old speed until the next command.
"""

from dataclasses import dataclass
from enum import Enum

from tetractl.lab.errors import WireError
from tetractl.model.wheels import COUNT_MAX

SIGNATURE_REQUEST = b"\x81"  # answered by 6 characters; stops the motors
BATTERY_REQUEST = b"\xb1"  # answered by 2 bytes, little-endian mV
STOP = b"\xc1\x00\xc5\x00"
_M1, _M2 = 0xC1, 0xC5  # forward; one more is backward


class Motor(Enum):
    """M1 is the left motor where nothing is swapped."""

    M1 = _M1
    M2 = _M2


@dataclass(frozen=True, slots=True)
class MotorCount:
    """A motor and its count in -127..127."""

    motor: Motor
    count: int


class Query(Enum):
    """A request that wants an answer."""

    SIGNATURE = 0x81
    BATTERY = 0xB1


def encode_wheels(left: int, right: int) -> bytes:
    """Pack both motors' counts in -127..127, four bytes."""
    return _motor(_M1, left) + _motor(_M2, right)


def decode_battery(answer: bytes) -> int:
    """Read the battery's answer [mV]."""
    if len(answer) != 2:
        raise WireError(f"a battery answer has 2 bytes, not {len(answer)}")
    return int.from_bytes(answer, "little")


def _motor(command: int, count: int) -> bytes:
    if not -COUNT_MAX <= count <= COUNT_MAX:
        raise WireError(f"wheel count {count} outside -{COUNT_MAX}..{COUNT_MAX}")
    return bytes((command if count >= 0 else command + 1, abs(count)))


class SlaveDecoder:
    """The robot's reading of the stream: the commands in bytes cut anywhere.

    `ignored` counts data bytes that no command was waiting for, commands that lost their data,
    and commands not named here.
    """

    def __init__(self) -> None:
        self.ignored = 0
        self._pending: tuple[Motor, int] | None = None  # motor and sign that wait for data

    def feed(self, data: bytes) -> list[MotorCount | Query]:
        """Take bytes as they came; return the commands they complete."""
        commands: list[MotorCount | Query] = []
        for byte in data:
            if byte < 0x80:
                if self._pending is None:
                    self.ignored += 1
                    continue
                motor, sign = self._pending
                self._pending = None
                commands.append(MotorCount(motor, sign * byte))
                continue
            self.ignored += self._pending is not None
            self._pending = _MOTORS.get(byte)
            if byte in _QUERIES:
                commands.append(Query(byte))
            elif self._pending is None:
                self.ignored += 1
        return commands


_QUERIES = frozenset(query.value for query in Query)
_MOTORS = {motor.value + back: (motor, 1 - 2 * back) for motor in Motor for back in (0, 1)}

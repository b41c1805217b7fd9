"""The bytes of the 3pi's own serial-slave program, which runs without an mbed.

Bytes from 0x80 on are commands, bytes below 0x80 are data of a command. **This program has no
watchdog**: without commands the motors continue to turn. If a data byte is lost, the motor keeps
its old speed until the next command.
"""

from tetractl.core.errors import WireError
from tetractl.model.wheels import COUNT_MAX

SIGNATURE_REQUEST = b"\x81"  # answered with 6 characters; also stops the motors
BATTERY_REQUEST = b"\xb1"  # answered with 2 bytes, little-endian mV
STOP = b"\xc1\x00\xc5\x00"
M1, M2 = 0xC1, 0xC5  # commands to drive forward; plus 1 to drive backward


def encode_wheels(left: int, right: int) -> bytes:
    """Pack both motors' counts, -127 to 127, into four bytes."""
    return _motor(M1, left) + _motor(M2, right)


def decode_battery(answer: bytes) -> int:
    """Return the battery voltage [mV] from the bytes of an answer."""
    if len(answer) != 2:
        raise WireError(f"a battery answer has 2 bytes, not {len(answer)}")
    return int.from_bytes(answer, "little")


def _motor(command: int, count: int) -> bytes:
    if not -COUNT_MAX <= count <= COUNT_MAX:
        raise WireError(f"wheel count {count} outside -{COUNT_MAX}..{COUNT_MAX}")
    return bytes((command if count >= 0 else command + 1, abs(count)))

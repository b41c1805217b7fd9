"""Encode commands to robots on two wheels as lines of text, and decode their replies.

A command is `T sequence flags {index v w} ...*CRC`, with v in mm/s and w in mrad/s. Alternatively,
it is `W sequence flags {index left right} ...*CRC`, with the speeds of the wheels in mm/s. A reply
is `S index sequence status battery_mv received rejected*CRC`. Numbers are decimal, with one space
between them. CRC is the CRC-16/CCITT-FALSE of everything before the *, as four hexadecimal digits.
LF ends a line. `firmware/twist_core.c` and `firmware/micropython/twist.py` are the counterparts on
the robot.
"""

from dataclasses import dataclass
from typing import Literal

from tetractl.core.errors import WireError
from tetractl.lab import cobs
from tetractl.lab.actuators.wheel_commands import Reply, Status

ROBOTS_MAX = 32
"""Maximum number of robots on a link. Their indices are 0 to 31."""
LINE_MAX = 300
"""Maximum length of a line without its end [characters]."""
SPEED_MAX = 5000
"""Maximum absolute speed in a command [mm/s]."""
TURN_MAX = 50_000
"""Maximum absolute turning rate in a command [mrad/s]."""
DIGITS_MAX = 6
"""Maximum number of digits of a number in a line."""
REPLY_SLOT_MS = 20
"""Length of a reply slot [ms]. Robot i replies i slots after a poll, so that no two collide."""
CommandType = Literal["T", "W"]
RobotEntry = tuple[int, int, int]
"""A robot's index with its two numbers: v [mm/s] and w [mrad/s], or both wheels' speeds [mm/s]."""


@dataclass(frozen=True, slots=True)
class LineCommand:
    """One line of text with the commands for all robots that receive it.

    Attributes:
        kind: "T" for speeds and turning rates, "W" for wheel speeds.
        sequence: Sequence number of the command, 0 to 255.
        flags: The flags of the command.
        entries: The index of each robot that drives, with its two numbers. All other robots stop.
    """

    kind: CommandType
    sequence: int
    flags: cobs.Flag
    entries: tuple[RobotEntry, ...] = ()


def encode_command(command: LineCommand) -> bytes:
    """Encode the speeds of robots as a line of text, including its end.

    Raises:
        WireError: If a number is out of range.
    """
    numbers = [
        command.sequence,
        int(command.flags),
        *(number for entry in command.entries for number in entry),
    ]
    content = " ".join([command.kind, *map(str, numbers)]).encode("ascii")
    line = content + b"*%04X\n" % cobs.crc16(content)
    if decode_command(line[:-1]) != command:
        raise WireError(f"this command cannot be sent: {command}")
    return line


def decode_command(line: bytes) -> LineCommand:
    """Decode a command from a line, which is given without its end.

    Raises:
        WireError: If the line is not a command.
    """
    letter, *numbers = _parse_numbers(line)
    if letter not in ("T", "W") or len(numbers) < 2 or len(numbers) % 3 != 2:
        raise WireError("not a command")
    second_max = SPEED_MAX if letter == "W" else TURN_MAX
    sequence, flags, *entry_numbers = numbers
    entries = tuple(zip(entry_numbers[::3], entry_numbers[1::3], entry_numbers[2::3], strict=True))
    for index, first_speed, second_speed in entries:
        if not (
            0 <= index < ROBOTS_MAX
            and abs(first_speed) <= SPEED_MAX
            and abs(second_speed) <= second_max
        ):
            raise WireError(
                f"robot {index} cannot drive at the speeds {first_speed} {second_speed}"
            )
    if not 0 <= sequence <= 255:
        raise WireError(f"the sequence number must be from 0 to 255, but it is {sequence}")
    return LineCommand(letter, sequence, cobs.parse_flags(flags), entries)


def decode_reply(line: bytes) -> Reply:
    """Decode a reply from a line, which is given without its end.

    Raises:
        WireError: If the line is not a reply.
    """
    letter, *numbers = _parse_numbers(line)
    if letter != "S" or len(numbers) != 6 or min(numbers) < 0:
        raise WireError("not a reply")
    index, sequence, status, *counters = numbers
    return Reply(index, sequence, Status(status & 7), *counters)


def _parse_numbers(line: bytes) -> tuple[str, *tuple[int, ...]]:
    """Split a line into its first letter and its numbers, and check its CRC.

    Raises:
        WireError: If its CRC or form is wrong.
    """
    line = line.removesuffix(b"\r")
    content = line[:-5]
    checksum = line[-5:]
    if not content or len(line) > LINE_MAX or checksum != b"*%04X" % cobs.crc16(content):
        raise WireError("wrong CRC")
    letter, *number_texts = content.decode("ascii", "replace").split(" ")
    for number_text in number_texts:
        digits = number_text.removeprefix("-")
        if not (digits.isascii() and digits.isdecimal() and len(digits) <= DIGITS_MAX):
            raise WireError(f"{number_text!r} is not a number")
    return letter, *map(int, number_texts)

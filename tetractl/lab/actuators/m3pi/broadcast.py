"""Encode commands to all m3pi robots in one radio frame, and decode their replies.

The robots' firmware has a watchdog, so they stop if no frame arrives. A command consists of the
bytes 0x51, sequence, flags, number of robots, then i8 left and i8 right for each robot, and a CRC.
A robot replies only when it is polled. A reply consists of the bytes 0x52, id, sequence, status,
u16 battery [mV], u16 frames received, u16 frames rejected, and a CRC. All numbers are
little-endian; `cobs.encode_with_crc` encodes the frames. `firmware/m3pi_core.c` is the counterpart
on the robot.
"""

import struct
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

from tetractl.core.clock import Clock
from tetractl.core.errors import AbortError, WireError
from tetractl.core.setup import Setup
from tetractl.lab import cobs
from tetractl.lab.actuators.wheel_commands import Reply, Status, poll_robots
from tetractl.lab.actuators.xbee.hardware import XbeeSection
from tetractl.lab.actuators.xbee.link import XbeeLink
from tetractl.lab.serial_port import SWITCH_OFF_HINT
from tetractl.model.wheels import COUNT_MAX, STOP, Counts
from tetractl.spec.lab_section import STOP_COUNT, STOP_GAP_NS

COMMAND = 0x51
"""First byte of a command."""
REPLY = 0x52
"""First byte of a reply."""
ROBOTS_MAX = 32
"""Maximum number of robots in a command. Their ids are 0 to 31."""
REPLY_SLOT_MS = 10
"""Length of a reply slot [ms]. Robot i replies i slots after a poll, so that no two collide."""
_REPLY = struct.Struct("<BBBBHHH")


@dataclass(frozen=True, slots=True)
class BroadcastCommand:
    """A command to all m3pi robots, which is sent in one frame.

    Robot i drives with the counts `wheels[i]`, or stops if `wheels` has no entry for it.
    """

    sequence: int
    flags: cobs.Flag
    wheels: tuple[Counts, ...] = ()


def encode_command(command: BroadcastCommand) -> bytes:
    """Encode a command as a frame, including the closing byte 00.

    Raises:
        WireError: If the sequence, the number of robots or a count does not fit into the frame.
    """
    if not 0 <= command.sequence <= 255:
        raise WireError(f"sequence {command.sequence} does not fit into one byte")
    if len(command.wheels) > ROBOTS_MAX:
        raise WireError(
            f"there are {len(command.wheels)} robots, but a frame has space for {ROBOTS_MAX}"
        )
    counts = [count for wheel_counts in command.wheels for count in wheel_counts]
    if any(len(wheel_counts) != 2 for wheel_counts in command.wheels):
        raise WireError(f"each robot needs two wheel counts, but these are {command.wheels}")
    if any(abs(count) > COUNT_MAX for count in counts):
        raise WireError(
            f"wheel counts must be from -{COUNT_MAX} to {COUNT_MAX}, but these are {command.wheels}"
        )
    header = bytes(
        [COMMAND, command.sequence, cobs.parse_flags(command.flags), len(command.wheels)]
    )
    return cobs.encode_with_crc(header + struct.pack(f"{len(counts)}b", *counts))


def decode_command(frame: bytes) -> BroadcastCommand:
    """Decode a command from a frame, which is given without the closing byte 00.

    Raises:
        WireError: If the frame is damaged or is not a valid command.
    """
    payload = cobs.decode_with_crc(frame)
    if len(payload) < 4 or payload[0] != COMMAND:
        raise WireError("not a command")
    sequence, flags, n_robots = payload[1:4]
    if n_robots > ROBOTS_MAX or len(payload) != 4 + 2 * n_robots:
        raise WireError(f"{len(payload)} bytes are not a command for {n_robots} robots")
    counts = struct.unpack_from(f"{2 * n_robots}b", payload, 4)
    if min(counts, default=0) < -COUNT_MAX:
        raise WireError(f"a wheel count is -128, below -{COUNT_MAX}")
    return BroadcastCommand(
        sequence, cobs.parse_flags(flags), tuple(zip(counts[::2], counts[1::2], strict=True))
    )


def decode_reply(frame: bytes) -> Reply:
    """Decode a robot's reply from a frame, which is given without the closing byte 00.

    Raises:
        WireError: If the frame is damaged or is not a reply.
    """
    robot, sequence, status, *counters = cobs.unpack_fields(_REPLY, REPLY, frame)
    return Reply(robot, sequence, Status(status & 7), *counters)


class Broadcaster:
    """Sends one frame with the commands of all robots over a radio link.

    Args:
        link: The connection to the XBee.
        clock: The clock for times.
        indices: Number of each robot, N entries, in the order of the setup.
    """

    def __init__(self, link: XbeeLink, clock: Clock, indices: Sequence[int]) -> None:
        self._link = link
        self._clock = clock
        self._indices = tuple(indices)
        self._sequence = clock.now() % 256  # an unpredictable first number
        self._splitter = cobs.FrameSplitter()  # for the data since the last poll

    def drive(self, counts: Sequence[Counts]) -> int:
        """Send every robot its wheel counts in one frame, and return the time of sending [ns].

        `counts` has one pair, left and right, for each robot in the order of the setup.
        """
        wheels = [STOP] * (max(self._indices) + 1)
        for index, wheel_counts in zip(self._indices, counts, strict=True):
            wheels[index] = wheel_counts
        return self.send(cobs.Flag.RUN, tuple(wheels))

    def send(self, flags: cobs.Flag, wheels: tuple[Counts, ...] = ()) -> int:
        """Send one frame, and return when it was sent [ns].

        The frame stops all robots if RUN is not among its flags.
        """
        self._sequence = (self._sequence + 1) % 256
        return self._link.send(encode_command(BroadcastCommand(self._sequence, flags, wheels)))

    def poll(self, timeout_s: float) -> list[Reply | None]:
        """Ask all robots for a reply, and wait for the replies.

        Args:
            timeout_s: How long to wait in total [s]. The function returns earlier if all robots
                have replied, or if the link fails.

        Returns:
            The reply of each robot. None if a robot is silent.
        """
        return poll_robots(self, self._indices, self._clock, timeout_s, REPLY_SLOT_MS)

    @property
    def failure(self) -> str | None:
        """Why nothing can be sent any more. None if there is no fault."""
        return self._link.failure

    def send_poll(self) -> tuple[int, int]:
        """Send a poll to all robots, and drop replies that have arrived before.

        Returns:
            The sequence number of the poll, and the time of sending [ns].
        """
        self._splitter = cobs.FrameSplitter()
        self._link.fetch()
        sent_ns = self.send(cobs.Flag.POLL)
        return self._sequence, sent_ns

    def receive_replies(self, timeout_s: float) -> Iterator[Reply]:
        """Wait at most `timeout_s` seconds for data, and yield the replies that arrived.

        Frames that are not replies are dropped.
        """
        self._link.wait(timeout_s)
        for frame in self._splitter.feed(b"".join(self._link.fetch())):
            with suppress(WireError):
                yield decode_reply(frame)


def stop_all(module: XbeeSection, _setup: Setup, clock: Clock, alone: bool) -> str:
    """Stop all robots in range, including robots that are not in the setup; see `stop_in_range`.

    Args:
        module: The section of the radio.
        _setup: Not used.
        clock: The clock for timeouts.
        alone: False if a run uses the port at the same time.
    """
    return stop_in_range(module, clock, alone)


def stop_in_range(module: XbeeSection, clock: Clock, alone: bool = True) -> str:
    """Latch the emergency stop of every robot in radio range, with ten frames within 200 ms.

    The module is not checked first, because sending through a wrong module is better than no stop.

    Args:
        module: The section of the radio.
        clock: The clock for timeouts.
        alone: False if another process may have the port open. That process could receive the
            answer, so no answer is expected.

    Returns:
        A summary.

    Raises:
        AbortError: If no module answers afterwards.
    """
    link = XbeeLink(module, clock)
    try:
        link.open(checked=False, exclusive=alone)
        broadcaster = Broadcaster(link, clock, ())
        for _ in range(STOP_COUNT):
            broadcaster.send(cobs.Flag.EMERGENCY_STOP)
            clock.sleep_until(clock.now() + STOP_GAP_NS)
        if alone and link.request_twice(b"AP") is None:
            raise AbortError(
                f"sent {STOP_COUNT} stops on {module.port}, but no XBee module answers at "
                f"{module.baud} baud",
                f"is this really the module's baud rate? {SWITCH_OFF_HINT}",
            )
    finally:
        link.close()
    return (
        f"sent {STOP_COUNT} stops on {module.port}; to drive the robots again, switch them off and "
        "on"
    )

"""The ports of robots that take lines of text: each port sends one line for all its robots."""

from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from functools import partial

from tetractl.core.clock import Clock, wait_for
from tetractl.core.errors import WireError
from tetractl.core.setup import Setup
from tetractl.lab.actuators.twist.lines import (
    REPLY_SLOT_MS,
    CommandType,
    LineCommand,
    RobotEntry,
    decode_reply,
    encode_command,
)
from tetractl.lab.actuators.twist.section import TwistSection
from tetractl.lab.actuators.wheel_commands import Reply, poll_robots
from tetractl.lab.cobs import Flag
from tetractl.lab.serial_port import OnReceived, PortFactory, PortGroup, stop_all_at
from tetractl.lab.udp_port import open_port
from tetractl.tools.worker import QUEUE_MAX, take_all

PORT_LOST_HINT = "the robots stop by their watchdog; connect the robots again, and restart the run"
PENDING_MAX = 1000
"""Maximum number of bytes that are kept of an unfinished line."""


class TwistLink(PortGroup):
    """The connection to robots that read lines of text, on one port or several.

    After a failure, which raises AbortError, nothing can be sent any more.

    Args:
        section: The fields of the actuator in the spec.
        names: Names of the robots, in the order of the setup.
        clock: The clock for times [ns].
        ports: Creates a port. None for `open_port`.
    """

    def __init__(
        self,
        section: TwistSection,
        names: Sequence[str],
        clock: Clock,
        ports: PortFactory | None = None,
    ) -> None:
        self._clock = clock
        self._command_type: CommandType = "T" if section.sends == "twist" else "W"
        self._indices = tuple(section.index(name) for name in names)
        self._indices_by_port: dict[str, set[int]] = {}
        """For each port, the indices of the robots that receive its lines."""
        for index, name in zip(self._indices, names, strict=True):
            self._indices_by_port.setdefault(section.port_of(name), set()).add(index)
        self._replies: deque[Reply] = deque(maxlen=QUEUE_MAX)
        self._unfinished_lines: dict[str, bytes] = {}
        self._sequence = clock.now() % 256  # an unpredictable first number
        create_port = ports or open_port
        super().__init__(
            create_port(
                port, section.baud, "the radio", clock, self._create_receiver(port), PORT_LOST_HINT
            )
            for port in self._indices_by_port
        )

    def drive(self, commands: Sequence[tuple[int, int]]) -> int:
        """Send each robot its two numbers, and return when the last line was sent [ns].

        The numbers are speed [mm/s] and turning rate [mrad/s], or the speeds of left and right
        wheel [mm/s], as the section's field `sends` says.
        """
        entries = [(i, *command) for i, command in zip(self._indices, commands, strict=True)]
        return self._send(Flag.RUN, entries)

    def stop(self, emergency: bool = False) -> int:
        """Stop every robot on every port, even if a port fails.

        Returns:
            The time of the last sending [ns].

        Raises:
            AbortError: If a port has failed.
        """
        return self._send(Flag.EMERGENCY_STOP if emergency else Flag(0), [])

    def poll(self, timeout_s: float) -> list[Reply | None]:
        """Ask all robots for a reply, and wait for the replies.

        Args:
            timeout_s: How long to wait in total [s]. The function returns earlier if all robots
                have replied, or if a port fails.

        Returns:
            The reply of each robot. None if a robot is silent.
        """
        return poll_robots(self, self._indices, self._clock, timeout_s, REPLY_SLOT_MS)

    def send_poll(self) -> tuple[int, int]:
        """Send a poll to all robots, and drop replies that have arrived before.

        Returns:
            The sequence number of the poll, and the time of sending [ns].
        """
        self._replies.clear()
        sent_ns = self._send(Flag.POLL, [])
        return self._sequence, sent_ns

    def receive_replies(self, timeout_s: float) -> list[Reply]:
        """Return the replies received so far. If there are none, wait until a reply arrives.

        Args:
            timeout_s: The longest wait [s]. The list is empty if nothing arrives in this time, or
                if the port fails.
        """
        wait_for(self._clock, lambda: bool(self._replies) or self.failure is not None, timeout_s)
        return take_all(self._replies)

    def _send(self, flags: Flag, entries: Sequence[RobotEntry]) -> int:
        """Send each port a line for its robots, and return the time of sending [ns].

        Robots without an entry stop.
        """
        self._sequence = (self._sequence + 1) % 256
        lines: list[bytes] = []
        for indices_here in self._indices_by_port.values():
            entries_here = tuple(entry for entry in entries if entry[0] in indices_here)
            command = LineCommand(self._command_type, self._sequence, flags, entries_here)
            lines.append(encode_command(command))
        return self.send(lines)

    def _create_receiver(self, port: str) -> OnReceived:
        """Create the function that receives the replies of the robots on a port."""
        indices_here = self._indices_by_port[port]

        def take(data: bytes, now: int) -> None:
            *lines, rest = (self._unfinished_lines.get(port, b"") + data).split(b"\n")
            self._unfinished_lines[port] = rest[-PENDING_MAX:]
            for line in lines:
                with suppress(WireError):
                    reply = decode_reply(line)
                    if reply.id in indices_here:
                        self._replies.append(reply)

        return take


def stop_all(section: TwistSection, setup: Setup, clock: Clock, alone: bool) -> str:
    """Latch the emergency stop of every robot on the ports; see `ActuatorSection.stop_all`.

    Ten lines are sent within 200 ms.

    Args:
        section: The fields of the actuator in the spec.
        setup: The constants of the experiment, with the robots' names.
        clock: The clock for timeouts.
        alone: False if a run uses the ports at the same time.

    Returns:
        A sentence that tells the operator how many stops were sent.

    Raises:
        AbortError: If some robots were not reached. The error names them.
        PortHeldError: If `alone` is True and another process has a port open.
    """
    link = TwistLink(section, setup.names, clock)
    sent = stop_all_at(link.ports, partial(link.stop, emergency=True), clock, alone)
    return f"{sent}; to drive the robots again, switch them off and on"

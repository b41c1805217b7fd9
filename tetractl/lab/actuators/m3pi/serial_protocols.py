"""The two protocols of m3pi robots over a link: one broadcast for all, or one message each."""

from collections.abc import Sequence
from dataclasses import dataclass

from tetractl.core.clock import SECOND, Clock
from tetractl.core.errors import WireError
from tetractl.lab.actuators.m3pi import slave
from tetractl.lab.actuators.m3pi.broadcast import (
    REPLY_SLOT_MS,
    BroadcastCommand,
    Counts,
    Flag,
    Status,
    decode_reply,
    encode_command,
)
from tetractl.lab.actuators.m3pi.section import M3piSection
from tetractl.lab.actuators.xbee.link import Link
from tetractl.lab.cobs import Splitter
from tetractl.model.wheels import STOP

TRIES = 5


@dataclass(frozen=True, slots=True)
class RobotAnswer:
    """A robot's answer to a poll; `battery_mv` is 0 if unknown."""

    battery_mv: int
    emergency_stopped: bool = False


def build_protocol(
    section: M3piSection, names: Sequence[str], link: Link, clock: Clock
) -> "BroadcastProtocol | SlaveProtocol":
    """Return the protocol that the spec chooses, for the robots in `names`, in this order."""
    if section.protocol.watchdog:
        return BroadcastProtocol(link, clock, [section.index(name) for name in names])
    return SlaveProtocol(link, clock, [section.robot(name).address or 0 for name in names])


class BroadcastProtocol:
    """Sends all robots one frame with a checksum, in which robot i has the number `indices[i]`."""

    def __init__(self, link: Link, clock: Clock, indices: Sequence[int]) -> None:
        self._link, self._clock = link, clock
        self._indices = tuple(indices)
        self._sequence = 0

    def drive(self, counts: Sequence[Counts]) -> int:
        """Send every robot its wheel counts in one frame; return the time of sending [ns]."""
        wheels = [STOP] * (max(self._indices) + 1)
        for index, pair in zip(self._indices, counts, strict=True):
            wheels[index] = pair
        return self._send(Flag.RUN, tuple(wheels))

    def stop(self) -> int:
        """Stop all robots by a frame without the run flag; return the time of sending [ns]."""
        return self._send(Flag(0))

    def emergency(self) -> int:
        """Latch every robot's emergency stop by one frame; return the time of sending [ns]."""
        return self._send(Flag.EMERGENCY_STOP)

    def poll(self, timeout_s: float) -> list[RobotAnswer | None]:
        """Poll all robots until each has answered, at most five times, since frames may be lost; a
        robot without an answer gives None.
        """
        found: dict[int, RobotAnswer] = {}
        wanted = set(self._indices)
        slots = (max(self._indices) + 2) * REPLY_SLOT_MS * 1_000_000
        deadline = self._clock.now() + round(timeout_s * SECOND)
        for _ in range(TRIES):
            splitter = Splitter()
            self._link.fetch()
            until = min(deadline, self._send(Flag.POLL) + slots + SECOND // 10)
            while not wanted <= found.keys() and (left := until - self._clock.now()) > 0:
                self._link.wait(left / SECOND)
                for received in self._link.fetch():
                    for frame in splitter.feed(received.data):
                        _keep_reply(frame, found)
            if wanted <= found.keys() or self._clock.now() >= deadline:
                break
        return [found.get(index) for index in self._indices]

    def _send(self, flags: Flag, wheels: tuple[Counts, ...] = ()) -> int:
        self._sequence = (self._sequence + 1) % 256
        return self._link.send(encode_command(BroadcastCommand(self._sequence, flags, wheels)))


class SlaveProtocol:
    """Sends one message to each robot's address. The robots have no watchdog, and their emergency
    stop does not latch.
    """

    def __init__(self, link: Link, clock: Clock, addresses: Sequence[int]) -> None:
        self._link, self._clock = link, clock
        self._addresses = tuple(addresses)

    def drive(self, counts: Sequence[Counts]) -> int:
        """Send each robot its wheel counts; return the time of the last transmission [ns]."""
        messages = [slave.encode_wheels(*pair) for pair in counts]
        return self._each(messages)

    def stop(self) -> int:
        """Send each robot a stop; return the time of the last transmission [ns]."""
        return self._each([slave.STOP] * len(self._addresses))

    def emergency(self) -> int:
        """Send each robot a signature request, which also stops it, and then a stop; return the
        time of the last transmission [ns].
        """
        message = slave.SIGNATURE_REQUEST + slave.STOP
        return self._each([message] * len(self._addresses))

    def poll(self, timeout_s: float) -> list[RobotAnswer | None]:
        """Ask each robot for its battery voltage, for up to `timeout_s`; None without an answer."""
        return [self._battery(address, timeout_s) for address in self._addresses]

    def _battery(self, address: int, timeout_s: float) -> RobotAnswer | None:
        share = round(timeout_s * SECOND / TRIES)
        for _ in range(TRIES):
            self._link.fetch()
            until = self._link.send(slave.BATTERY_REQUEST, address) + share
            answer = b""
            while (left := until - self._clock.now()) > 0:
                self._link.wait(left / SECOND)
                answer += b"".join(r.data for r in self._link.fetch() if r.source == address)
                if len(answer) == 2:
                    return RobotAnswer(slave.decode_battery(answer))
        return None

    def _each(self, messages: Sequence[bytes]) -> int:
        """Send each robot its message, even after a failure; raise the first failure at the end."""
        failure: Exception | None = None
        sent = self._clock.now()
        for address, message in zip(self._addresses, messages, strict=True):
            try:
                sent = self._link.send(message, address)
            except Exception as error:
                failure = failure or error
        if failure is not None:
            raise failure
        return sent


def _keep_reply(frame: bytes, found: dict[int, RobotAnswer]) -> None:
    try:
        reply = decode_reply(frame)
    except WireError:
        return
    latched = bool(reply.status & Status.EMERGENCY_STOPPED)
    found[reply.id] = RobotAnswer(reply.battery_mv, latched)

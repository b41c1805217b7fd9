"""The emulated Motive: sends frames at the cameras' rate by NatNet over UDP, unicast or
multicast.
"""

import random
import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

from tetractl.core.clock import SECOND
from tetractl.core.errors import TetractlError, WireError
from tetractl.emulate.loop import Timeline
from tetractl.emulate.optitrack.natnet_server import (
    Address,
    MotiveServer,
    ServerCounts,
    Streaming,
    Trouble,
    pack_answer,
    pack_modeldef,
    parse_request,
)
from tetractl.lab.cameras.optitrack.natnet_messages import (
    NEWEST,
    OLDEST,
    BodyName,
    Message,
    MessageKind,
    ModelDef,
    NatNetFrame,
    RigidBody,
    Ticks,
    Version,
)
from tetractl.lab.cameras.optitrack.wire import datagram

MODELS_CHANGED, EDIT_MODE = 2, 4
GROWN = bytes(24)  # extra bytes in descriptions of bodies above protocol 4.3
DATAGRAMS_A_TURN = 100


class Motive:
    """An emulated Motive server. `expose` returns the bodies at the timeline's present moment.

    Exposures are numbered from 1, without gaps. `on_exposed(exposure, frame number)` is called at
    each exposure, and `on_sent(exposure)` when its datagrams are sent or would be sent without a
    fault. `on_client(address)` is called for each new client. `bound(address, port)` opens a UDP
    socket.
    """

    def __init__(
        self,
        timeline: Timeline,
        streaming: Streaming,
        names: list[BodyName],
        expose: Callable[[], tuple[RigidBody, ...]],
        on_exposed: Callable[[int, int], None],
        on_sent: Callable[[int], None],
        on_client: Callable[[str], None],
        seed: int,
        bound: Callable[[str, int], Any] | None = None,
    ) -> None:
        self.streaming = streaming
        self._bound = bound or bound_udp
        self.trouble = Trouble()
        self.counts = ServerCounts()
        self.server = MotiveServer(streaming, names, self.counts, on_client)
        self._timeline = timeline
        self._expose = expose
        self._on_exposed = on_exposed
        self._on_sent = on_sent
        self._random = random.Random(seed)
        self._last: NatNetFrame | None = None
        self._start_ns = 0
        self._exposures = 0
        self.command: Any = None
        self.data: Any = None

    @property
    def now_ns(self) -> int:
        """The timeline's present moment [ns]."""
        return self._timeline.now_ns

    @property
    def command_port(self) -> int:
        """The UDP port for commands; after `open`, the port really opened."""
        return self.streaming.command_port if self.command is None else _port(self.command)

    @property
    def data_port(self) -> int:
        """The UDP port from which frames are sent or, in multicast, to which they are sent."""
        return self.server.data_port

    def open(self) -> int:
        """Open the ports and expose the first frame now; return the file descriptor to watch."""
        s = self.streaming
        multicast = s.transport == "multicast"
        self.command = self._bound(s.address, s.command_port)
        self.data = self._bound(s.frames_from or s.address, 0 if multicast else s.data_port)
        if multicast:
            interface = socket.inet_aton(s.address)
            self.data.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, interface)
        if not (multicast and s.data_port):
            # in multicast too, since no other server uses this port
            self.server.data_port = _port(self.data)
        self._start_ns = self._timeline.now_ns
        self._plan()
        return self.command.fileno()

    def close(self) -> None:
        """Release the ports; may be called twice."""
        for opened in (self.command, self.data):
            if opened is not None:
                opened.close()

    def readable(self, catch_up: Callable[[], None] = lambda: None) -> None:
        """Answer the messages at the command port; `catch_up` advances the timeline before each."""
        assert self.command is not None, "it is open"
        for _ in range(DATAGRAMS_A_TURN):
            try:
                asked, sender = self.command.recvfrom(65_535)
            except BlockingIOError:
                return
            except OSError:  # a client has gone: its host answered port unreachable
                continue
            if self.trouble.silent:
                continue
            catch_up()  # otherwise an echo could report a time before its request
            try:
                message = parse_request(asked)
            except WireError:
                self.counts.refused += 1
                continue
            answer = self.server.answer(message, sender, self._timeline.now_ns)
            if answer is not None:
                self._send(self.command, _packed(answer, self.server.version(sender)), sender)

    def _plan(self) -> None:
        due = self._start_ns + round(self._exposures * SECOND / self.streaming.rate_hz)
        self._exposures += 1
        self._timeline.at(due, self._take)

    def _take(self) -> None:
        """Expose one frame, and schedule its sending after the server's latency."""
        now = self._timeline.now_ns
        number = self._exposures - self.trouble.counter
        self._on_exposed(self._exposures, number)
        s, jitter = self.streaming, self._random
        delay = s.latency + min(max(jitter.gauss(0, s.jitter), -4 * s.jitter), 4 * s.jitter)
        if jitter.random() < 1 / 250:
            delay += jitter.uniform(0, 0.45 / s.rate_hz)
        leaves = now + round(delay * SECOND)
        exposed = now
        if self.trouble.outdated:
            self.trouble.outdated -= 1
            exposed = max(0, now - round(self.trouble.outdated_s * SECOND))
        ticks = self.server.clock.ticks
        frame = NatNetFrame(
            number,
            self._expose(),
            params=MODELS_CHANGED * s.models_changed | EDIT_MODE * self.trouble.edit_mode,
            ticks=Ticks(ticks(exposed), ticks(now + round(0.6 * delay * SECOND)), 0),
        )
        self._timeline.at(leaves, partial(self._transmit, self._exposures, frame))
        self._plan()

    def _transmit(self, exposure: int, frame: NatNetFrame) -> None:
        now = self._timeline.now_ns
        if self.trouble.frozen and self._last is not None:
            frame = self._last
        self._last = frame
        if not (self.trouble.silent or self.trouble.no_frames):
            self._stream(frame, now)
        self._on_sent(exposure)

    def _stream(self, frame: NatNetFrame, now: int) -> None:
        if frame.ticks is not None:
            frame = replace(
                frame, ticks=replace(frame.ticks, transmit=self.server.clock.ticks(now))
            )
        packed: dict[Version, bytes] = {}
        for address, version in self.server.receivers(now):
            if version not in packed:
                packed[version] = _packed(frame, self.trouble.version or version)
            message = packed[version]
            if self.trouble.damaged and self._random.random() < self.trouble.damaged:
                message = mangle(message, self._random)
            self._send(self.data, message, address)
        self.counts.frames += 1

    def _send(self, sender: Any, data: bytes, to: Address) -> None:
        assert sender is not None, "it is open"
        with suppress(OSError):  # the datagram is lost if a buffer is full or the client has gone
            sender.sendto(data, to)
            self.counts.datagrams += 1


def mangle(datagram: bytes, chance: random.Random) -> bytes:
    """Return a datagram with damage drawn by `chance`: cut, extended, a wrong field, or noise."""
    match chance.randrange(5):
        case 0:
            return datagram[: chance.randrange(len(datagram))]
        case 1:
            return datagram + bytes(chance.randrange(1, 20))
        case 2:
            return datagram[:2] + (len(datagram) + 7).to_bytes(2, "little") + datagram[4:]
        case 3:  # an impossible number of bodies
            return datagram[:8] + b"\xff\xff\xff\x7f" + datagram[12:]
        case _:
            return chance.randbytes(chance.randrange(1, 1400))


def _packed(message: Message, version: Version) -> bytes:
    """Pack a message in a protocol version; versions before 2.6 are packed as 2.6, versions after
    4.3 as 4.3.
    """
    if version > NEWEST and isinstance(message, ModelDef):
        return datagram(MessageKind.MODELDEF, pack_modeldef(message, NEWEST, grown=GROWN))
    return pack_answer(message, max(OLDEST, min(version, NEWEST)))


def _port(of: Any) -> int:
    return of.getsockname()[1]


def bound_udp(address: str, port: int) -> socket.socket:
    """Return a UDP socket bound to an address; TetractlError if the port is in use."""
    bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        bound.setblocking(False)
        bound.bind((address, port))
    except OSError as error:
        bound.close()
        raise TetractlError(
            f"cannot open UDP {address}:{port}: {error.strerror}",
            hint="is another emulation or Motive running? Choose other ports with --command-port "
            "and --data-port; 0 takes any free port",
        ) from None
    return bound

"""The emulated Motive: sends frames at the cameras' rate by NatNet over UDP, unicast or
multicast.
"""

import random
import socket
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

from pydantic import Field

from tetractl.core.clock import SECOND
from tetractl.core.commands import EMULATED_NAME
from tetractl.core.errors import WireError
from tetractl.emulate.optitrack.natnet_server import mangle, pack_answer, parse_request
from tetractl.emulate.sides import Stage
from tetractl.experiment.base import Finite, Model, Name, NonNegative, Positive
from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.pose import UpAxis
from tetractl.lab.cameras.optitrack.section import Ipv4, OptitrackSection, VersionText

JITTER_S = 0.00025  # standard deviation of the time from exposure to transmission


class TrueBody(Model):
    """True properties of a robot's rigid body that differ from the spec."""

    name: Name
    """Name of a robot of the spec."""
    heading_offset: Finite | None = None
    """Heading of the robot minus heading of its rigid body [rad]."""
    body: str | None = Field(default=None, min_length=1, max_length=64)
    """Name of the body in Motive."""
    streamed: bool = True
    """Whether the body is in the frames; it is always in the list of names."""


class OptitrackSettings(Model):
    """Properties of the cameras that differ from the spec."""

    version: VersionText = "4.1"
    """The camera server's protocol version, 2.5 or later; frames of 2.5 have the layout of 2.6.
    Versions above 4.3 have the layout of 4.3 with longer descriptions of rigid bodies."""
    keeps_version: bool = False
    """Whether the server streams in its own version to clients that request another version."""
    frames_from: Ipv4 | None = None
    """Address from which frames are sent, such as a second network card; by default the server's.
    """
    answers_models: bool = True
    """Whether the server reports the names of its rigid bodies."""
    models_changed: bool = False
    """Whether every frame reports that the rigid bodies have changed."""
    rate: float = Field(default=120.0, ge=1, le=500)
    """Camera frames per second [Hz]."""
    latency: float = Field(default=0.0054, ge=0, le=1)
    """Mean time from exposure to transmission [s]; on average, one frame in 250 is delayed further,
    by up to nearly half a frame period."""
    unit_mm: Positive = 1000.0
    """Unit of length that the server reports [mm]; positions are always in metres."""
    noise_mm: NonNegative = 0.0
    """Standard deviation of a body's position along each axis of the floor [mm]."""
    noise_rad: NonNegative = 0.0
    """Standard deviation of a body's heading [rad]."""
    knows_up_axis: bool = True
    """Whether the server answers `UpAxis`."""
    robots: tuple[TrueBody, ...] = ()
    """Robots whose rigid bodies have another name or heading offset than in the spec, or are not
    streamed."""


@dataclass(slots=True)
class Trouble:
    """The present faults: the server is silent (no answers, no frames), sends no frames, repeats
    the same frame (`frozen`), has set its frame counter back by `counter`, is in edit mode, damages
    the fraction `damaged` of its frames, packs frames in another `version`, or sends `outdated`
    frames whose exposure times are `outdated_s` [s] too early.
    """

    silent: bool = False
    no_frames: bool = False
    frozen: bool = False
    counter: int = 0
    edit_mode: bool = False
    damaged: float = 0.0
    version: natnet.Version | None = None
    outdated: int = 0
    outdated_s: float = 0.0


@dataclass(slots=True)
class Client:
    """A unicast client: the protocol version in which it is served, and when it was last heard
    [ns].
    """

    version: natnet.Version
    heard_ns: int


CLOCK_HZ = 10_000_000
Address = tuple[str, int]


@dataclass(slots=True)
class ServerClock:
    """The server's clock. Up to the host time `since_ns` it is `ahead_ns` ahead of the host's
    clock; from then on it advances by `rate` seconds per second.
    """

    ahead_ns: int = 0
    rate: float = 1.0
    since_ns: int = 0

    def ticks(self, when_ns: int) -> int:
        """Return the time on the server's clock [ticks] at a time on the host's clock [ns]."""
        gained = round((self.rate - 1.0) * max(0, when_ns - self.since_ns))
        start = 0x1234_5678_9ABC  # of the server's clock, which is arbitrary [ticks]
        return start + (when_ns + self.ahead_ns + gained) * CLOCK_HZ // SECOND


class Motive:
    """An emulated Motive server. `expose` returns the bodies at the timeline's present moment.

    Exposures are numbered from 1, without gaps. `data_port` is the UDP port from which frames are
    sent or, in multicast, to which they are sent; `command_port` is that of messages. `frames`,
    `refused`, `models_asked` and `timed_out` are numbers of frames sent, of requests that could not
    be read, of requests for MODELDEF, and of clients dropped because they were silent.
    """

    def __init__(
        self,
        stage: Stage,
        section: OptitrackSection,
        settings: OptitrackSettings,
        up: UpAxis,
        names: Sequence[tuple[str, int]],
        expose: Callable[[], tuple[natnet.RigidBody, ...]],
    ) -> None:
        options = stage.options
        self.section, self.settings, self.up, self.names = section, settings, up, tuple(names)
        self.address = options.address or section.server
        self.command_port, self.data_port = section.command_port, section.data_port
        if options.command_port is not None:
            self.command_port = options.command_port
        if options.data_port is not None:
            self.data_port = options.data_port
        self.multicast = section.transport == "multicast"
        self.own_version = natnet.Version.of(settings.version)
        self.trouble, self.clock = Trouble(), ServerClock()
        self.clients: dict[Address, Client] = {}
        self.frames = self.refused = self.models_asked = self.timed_out = 0
        self._greeted: set[Address] = set()
        self._stage, self.timeline, self._expose = stage, stage.timeline, expose
        self._random = random.Random(options.seed)
        self._last: natnet.NatNetFrame | None = None
        self._start_ns = self._exposures = 0
        self.command: Any = None
        self.data: Any = None

    def open(self) -> int:
        """Open the ports and expose the first frame now; return the file descriptor to watch."""
        bound = self._stage.wires.bound
        self.command = bound(self.address, self.command_port)
        self.command_port = _port(self.command)
        sender = self.settings.frames_from or self.address
        self.data = bound(sender, 0 if self.multicast else self.data_port)
        if self.multicast:
            interface = socket.inet_aton(self.address)
            self.data.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, interface)
        if not (self.multicast and self.data_port):
            # in multicast too, since no other server uses this port
            self.data_port = _port(self.data)
        self._start_ns = self.timeline.now_ns
        self._plan()
        return self.command.fileno()

    def close(self) -> None:
        """Release the ports; may be called twice."""
        for opened in (self.command, self.data):
            if opened is not None:
                opened.close()

    def readable(self, catch_up: Callable[[], None] = lambda: None) -> None:
        """Answer the messages at the command port; `catch_up` advances the timeline before each."""
        for _ in range(100):
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
                self.refused += 1
                continue
            answer = self._answer(message, sender, self.timeline.now_ns)
            if answer is not None:
                known = self.clients.get(sender)
                version = known.version if known else self.own_version
                self._send(self.command, pack_answer(answer, version), sender)

    def _answer(
        self, message: natnet.ClientMessage, sender: Address, now_ns: int
    ) -> natnet.ServerMessage | None:
        """Return the answer to a message, None if the server gives no answer."""
        if sender in self.clients:
            self.clients[sender].heard_ns = now_ns
        match message:
            case natnet.Connect():
                self._admit(message, sender, now_ns)
                name = f"Motive ({EMULATED_NAME})"
                return natnet.ServerInfo(name, self.own_version, CLOCK_HZ, self.data_port)
            case natnet.EchoRequest(client):
                return natnet.EchoResponse(client, self.clock.ticks(now_ns))
            case natnet.NatNetRequest("UnitsToMillimeters"):
                return natnet.Response(struct.pack("<f", self.settings.unit_mm))
            case natnet.NatNetRequest("UpAxis") if self.settings.knows_up_axis:
                return natnet.Response(struct.pack("<i", self.up))
            case natnet.NatNetRequest():
                return natnet.Bare(natnet.MessageKind.UNRECOGNIZED)
            case natnet.Bare(natnet.MessageKind.REQUEST_MODELDEF):
                self.models_asked += 1
                return natnet.ModelDef(self.names) if self.settings.answers_models else None
            case natnet.Bare(natnet.MessageKind.DISCONNECT):
                self.clients.pop(sender, None)
        return None

    def _admit(self, message: natnet.Connect, sender: Address, now_ns: int) -> None:
        """Add a client; from 4.0 on, a unicast client may choose a version."""
        if sender not in self._greeted:
            self._greeted.add(sender)
            self._stage.client(f"{sender[0]}:{sender[1]}")
        if self.multicast:
            return
        version, own = message.version, self.own_version
        chosen = message.pinned and not self.settings.keeps_version
        chosen = chosen and (4, 0) <= own >= version and version.known
        self.clients[sender] = Client(version if chosen else own, now_ns)

    def _receivers(self, now_ns: int) -> Iterator[tuple[Address, natnet.Version]]:
        """Yield the addresses to which frames are sent, each with its protocol version; in
        unicast, first drop the clients that have been silent for too long.
        """
        if self.multicast:
            yield (self.section.group, self.data_port), self.own_version
        for address, client in list(self.clients.items()):
            if now_ns - client.heard_ns > 5 * SECOND:
                del self.clients[address]
                self.timed_out += 1
            else:
                yield address, client.version

    def _plan(self) -> None:
        due = self._start_ns + round(self._exposures * SECOND / self.settings.rate)
        self._exposures += 1
        self.timeline.at(due, self._take)

    def _take(self) -> None:
        """Expose one frame, and schedule its sending after the server's latency."""
        exposed = now = self.timeline.now_ns
        number = self._exposures - self.trouble.counter
        self._stage.exposed(self._exposures, number)
        s, jitter = self.settings, self._random
        delay = s.latency + min(max(jitter.gauss(0, JITTER_S), -4 * JITTER_S), 4 * JITTER_S)
        if jitter.random() < 1 / 250:
            delay += jitter.uniform(0, 0.45 / s.rate)
        if self.trouble.outdated:
            self.trouble.outdated -= 1
            exposed = max(0, now - round(self.trouble.outdated_s * SECOND))
        params = 2 * s.models_changed | 4 * self.trouble.edit_mode  # as `NatNetFrame` reads them
        frame = natnet.NatNetFrame(number, self._expose(), params, self.clock.ticks(exposed))
        leaves = now + round(delay * SECOND)
        self.timeline.at(leaves, partial(self._leave, self._exposures, frame))
        self._plan()

    def _leave(self, exposure: int, frame: natnet.NatNetFrame) -> None:
        if self.trouble.frozen and self._last is not None:
            frame = self._last
        self._last = frame
        if not (self.trouble.silent or self.trouble.no_frames):
            self._stream(frame, self.timeline.now_ns)
        self._stage.sent(exposure)

    def _stream(self, frame: natnet.NatNetFrame, now: int) -> None:
        packed: dict[natnet.Version, bytes] = {}
        for address, version in self._receivers(now):
            if version not in packed:
                packed[version] = pack_answer(frame, self.trouble.version or version)
            message = packed[version]
            if self.trouble.damaged and self._random.random() < self.trouble.damaged:
                message = mangle(message, self._random)
            self._send(self.data, message, address)
        self.frames += 1

    def _send(self, sender: Any, data: bytes, to: Address) -> None:
        with suppress(OSError):  # the datagram is lost if a buffer is full or the client has gone
            sender.sendto(data, to)


def _port(of: Any) -> int:
    return of.getsockname()[1]

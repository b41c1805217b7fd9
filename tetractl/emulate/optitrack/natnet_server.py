"""The emulated Motive without its sockets: settings, clients and answers; reads clients' messages,
and packs answers and frames.
"""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from tetractl.core.clock import SECOND
from tetractl.core.commands import EMULATED_NAME
from tetractl.core.errors import WireError
from tetractl.lab.cameras.optitrack.natnet_messages import (
    MULTICAST_GROUP,
    Bare,
    BodyName,
    Connect,
    EchoRequest,
    EchoResponse,
    Message,
    MessageKind,
    ModelDef,
    NatNetFrame,
    NatNetRequest,
    Response,
    RigidBody,
    ServerInfo,
    Ticks,
    Vec3,
    Version,
)
from tetractl.lab.cameras.optitrack.payloads import RIGID_BODY, SIZED, packed, packed_name
from tetractl.lab.cameras.optitrack.pose import UpAxis
from tetractl.lab.cameras.optitrack.wire import (
    SENDER,
    datagram,
    quad,
    read_sender,
    read_text,
    sender,
    split,
    u64,
)

EMULATED_VERSION = Version(4, 1)


@dataclass(frozen=True, slots=True)
class Streaming:
    """Motive's streaming settings. Port 0 takes any free port; times are in seconds.

    The time from exposure to transmission has the mean `latency` and the standard deviation
    `jitter`; on average, one frame in 250 is delayed further, by up to nearly half a frame period.
    A version above 4.3 is packed as 4.3, with longer descriptions of rigid bodies. `keeps_version`:
    clients cannot choose another version; `answers_models`: requests for MODELDEF are answered;
    `models_changed`: every frame reports changed models; `unit_mm`: the answer to
    `UnitsToMillimeters`, although positions are always in metres.
    """

    address: str = "127.0.0.1"
    command_port: int = 1510
    data_port: int = 1511
    transport: Literal["unicast", "multicast"] = "unicast"
    group: str = MULTICAST_GROUP
    version: Version = EMULATED_VERSION
    rate_hz: float = 120.0
    latency: float = 0.0054
    jitter: float = 0.00025
    client_timeout: float = 5.0
    frames_from: str | None = None  # a separate address, such as a second network card's
    keeps_version: bool = False
    answers_models: bool = True
    models_changed: bool = False
    unit_mm: float = 1000.0
    up: UpAxis = UpAxis.Y
    knows_up_axis: bool = True


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
    version: Version | None = None
    outdated: int = 0
    outdated_s: float = 0.0


@dataclass(slots=True)
class Client:
    """A unicast client: the protocol version in which it is served, and when it was last heard
    [ns].
    """

    version: Version
    heard_ns: int


@dataclass(slots=True)
class ServerCounts:
    """Numbers of frames sent, of datagrams sent, of requests that could not be read, of requests
    for MODELDEF, and of clients dropped because they were silent.
    """

    frames: int = 0
    datagrams: int = 0
    refused: int = 0
    models_asked: int = 0
    timed_out: int = 0


CLOCK_HZ = 10_000_000
CLOCK_OFFSET = 0x1234_5678_9ABC  # arbitrary start of the server's clock [ticks]
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
        return CLOCK_OFFSET + (when_ns + self.ahead_ns + gained) * CLOCK_HZ // SECOND


class MotiveServer:
    """Answers clients and keeps a list of them; `on_client` is called with each new client's
    address.

    `data_port` is the port from which frames are sent or, in multicast, to which they are sent.
    """

    def __init__(
        self,
        streaming: Streaming,
        names: Sequence[BodyName],
        counts: ServerCounts,
        on_client: Callable[[str], None],
    ) -> None:
        self.streaming = streaming
        self.clients: dict[Address, Client] = {}
        self.data_port = streaming.data_port
        self.clock = ServerClock()
        self._names = tuple(names)
        self._counts = counts
        self._on_client = on_client
        self._greeted: set[Address] = set()

    def version(self, client: Address) -> Version:
        """Return the protocol version in which a client is served."""
        known = self.clients.get(client)
        return known.version if known else self.streaming.version

    def answer(self, message: Message, sender: Address, now_ns: int) -> Message | None:
        """Return the answer to a message, None if the server gives no answer."""
        if sender in self.clients:
            self.clients[sender].heard_ns = now_ns
        match message:
            case Connect():
                self._admit(message, sender, now_ns)
                return self._info()
            case EchoRequest(client):
                return EchoResponse(client, self.clock.ticks(now_ns))
            case NatNetRequest(text) if text.startswith("Bitstream,"):
                return self._change_version(text.removeprefix("Bitstream,"), sender)
            case NatNetRequest(text):
                return self._reply(text)
            case Bare(MessageKind.REQUEST_MODELDEF):
                self._counts.models_asked += 1
                return ModelDef(self._names) if self.streaming.answers_models else None
            case Bare(MessageKind.DISCONNECT):
                self.clients.pop(sender, None)
        return None

    def receivers(self, now_ns: int) -> list[tuple[Address, Version]]:
        """Return the addresses to which frames are sent, each with its protocol version; in
        unicast, first drop the clients that have been silent for `client_timeout`.
        """
        s = self.streaming
        if s.transport == "multicast":
            return [((s.group, self.data_port), s.version)]
        silent = round(s.client_timeout * SECOND)
        for address, client in list(self.clients.items()):
            if now_ns - client.heard_ns > silent:
                del self.clients[address]
                self._counts.timed_out += 1
        return [(address, client.version) for address, client in self.clients.items()]

    def _admit(self, message: Connect, sender: Address, now_ns: int) -> None:
        if sender not in self._greeted:
            self._greeted.add(sender)
            self._on_client(f"{sender[0]}:{sender[1]}")
        if self.streaming.transport == "multicast":
            return
        version = self.streaming.version
        if message.bitstream is not None and self._can_change(asked := message.bitstream[:2]):
            version = Version(*asked)
        self.clients[sender] = Client(version, now_ns)

    def _can_change(self, asked: tuple[int, int]) -> bool:
        """Return whether a unicast client may choose a version; servers before 4.0 do not allow
        that.
        """
        version = Version(*asked)
        if self.streaming.keeps_version:
            return False
        return (4, 0) <= self.streaming.version >= version and version.known

    def _change_version(self, text: str, sender: Address) -> Message:
        major, _, minor = text.partition(".")
        known = self.clients.get(sender)
        numbers = major.isdecimal() and minor.isdecimal()
        if known and numbers and self._can_change((int(major), int(minor))):
            known.version = Version(int(major), int(minor))
            return Response(struct.pack("<i", 0))
        return Response(struct.pack("<i", 1))

    def _info(self) -> ServerInfo:
        a, b, c, d = (int(part) for part in self.streaming.group.split("."))
        major, minor = self.streaming.version
        return ServerInfo(
            f"Motive ({EMULATED_NAME})",
            (3, 0, 0, 0),
            (major, minor, 0, 0),
            CLOCK_HZ,
            self.data_port,
            self.streaming.transport == "multicast",
            (a, b, c, d),
        )

    def _reply(self, text: str) -> Message:
        match text:
            case "FrameRate":
                return Response(struct.pack("<f", self.streaming.rate_hz))
            case "UnitsToMillimeters":
                return Response(struct.pack("<f", self.streaming.unit_mm))
            case "UpAxis" if self.streaming.knows_up_axis:
                return Response(struct.pack("<i", self.streaming.up))
            case _:
                return Bare(MessageKind.UNRECOGNIZED)


CONNECT_4 = SENDER + 5  # from 4.x clients: u8 subscribed only, bitstream version[4]
MEAN_ERROR_M = 0.0002  # mean marker error of a tracked body


def parse_request(received: bytes) -> Message:
    """Read one datagram of a client; WireError if it cannot be read."""
    kind, payload = split(received)
    match kind:
        case MessageKind.CONNECT if len(payload) < SENDER:  # minimal clients send only a name
            return Connect(read_text(payload))
        case MessageKind.CONNECT if len(payload) < CONNECT_4:
            return Connect(*read_sender(payload))
        case MessageKind.CONNECT:
            subscribed = payload[SENDER] != 0
            return Connect(*read_sender(payload), subscribed, quad(payload, SENDER + 1))
        case MessageKind.REQUEST:
            return NatNetRequest(read_text(payload))
        case MessageKind.ECHO_REQUEST:
            return EchoRequest(u64(payload, 0, 8))
        case _:
            return Bare(kind)


def pack_answer(message: Message, version: Version | None = None) -> bytes:
    """Pack one datagram of the server; for frames and models, `version` must be 2.6 to 4.3."""
    match message:
        case NatNetFrame() | ModelDef() if version is None:
            raise WireError("frames and models need a protocol version")
        case NatNetFrame():
            assert version is not None
            return datagram(MessageKind.FRAME, pack_frame(message, version))
        case ModelDef():
            assert version is not None
            return datagram(MessageKind.MODELDEF, pack_modeldef(message, version))
        case ServerInfo():
            return datagram(MessageKind.SERVER_INFO, _server_info(message))
        case Response(payload):
            return datagram(MessageKind.RESPONSE, payload)
        case EchoResponse(client, server):
            return datagram(MessageKind.ECHO_RESPONSE, packed("QQ", client, server))
        case Bare(MessageKind.UNRECOGNIZED as kind):
            return datagram(kind, b"")
        case _:
            raise WireError(f"a server does not send {type(message).__name__}")


def _server_info(info: ServerInfo) -> bytes:
    payload = sender(info.name, info.app_version, info.natnet_version)
    if info.version < (3, 0):
        return payload
    group = info.group or (0, 0, 0, 0)
    return payload + packed(
        "QH?4B", info.clock_hz or 0, info.data_port or 0, info.multicast, *group
    )


def pack_frame(frame: NatNetFrame, version: Version) -> bytes:
    """Pack a frame's payload: rigid bodies, and all other sections empty."""
    if not version.known:
        raise WireError(f"protocol {version} cannot be packed")
    bodies = [packed_body(body, version) for body in frame.bodies]
    after = 2 + (version >= SIZED) + (version >= (2, 9)) + (version >= (2, 11))
    empty = section([], version)
    return b"".join(
        (
            packed("i", frame.number),
            empty * 2,  # marker sets and other markers
            section(bodies, version),
            empty * after,  # skeletons, assets, labelled markers, force plates, devices
            suffix(frame, version),
        )
    )


def section(parts: Sequence[bytes], version: Version) -> bytes:
    """Pack a section of a frame from its packed elements."""
    size = sum(map(len, parts))
    head = packed("ii", len(parts), size) if version >= SIZED else packed("i", len(parts))
    return head + b"".join(parts)


def packed_body(body: RigidBody, version: Version, markers: Sequence[Vec3] = ()) -> bytes:
    """Pack a rigid body, in versions before 3.0 with its markers."""
    parts = [packed("i7f", body.id, *body.position, *body.quaternion)]
    if version < (3, 0):
        parts.append(packed("i", len(markers)) + b"".join(packed("3f", *at) for at in markers))
        parts.append(packed(f"{len(markers)}i", *range(len(markers))))
        parts.append(packed(f"{len(markers)}f", *[0.01] * len(markers)))
    error = MEAN_ERROR_M if body.tracking_valid else 0.0
    return b"".join((*parts, packed("fH", error, body.tracking_valid)))


def suffix(frame: NatNetFrame, version: Version) -> bytes:
    """Pack a frame's suffix: ticks and params, and zeros for timecode, latency and time stamp."""
    if version < (3, 0):
        return packed("fIIfHi" if version < (2, 7) else "fIIdHi", 0.0, 0, 0, 0.0, frame.params, 0)
    ticks = frame.ticks or Ticks(0, 0, 0)
    stamps = packed("IId3Q", 0, 0, 0.0, ticks.exposure, ticks.received, ticks.transmit)
    return stamps + (bytes(8) if version >= SIZED else b"") + packed("Hi", frame.params, 0)


def pack_modeldef(
    model: ModelDef,
    version: Version,
    others: Sequence[tuple[int, bytes]] = (),
    markers: int = 0,
    grown: bytes = b"",
) -> bytes:
    """Pack a MODELDEF payload: first the data sets in `others`, each a type and bytes, then every
    rigid body with `markers` markers.

    `grown` is appended to each body's description, as a newer protocol would do.
    """
    if not version.known:
        raise WireError(f"protocol {version} cannot be packed")
    described = (_packed_body(body, version, markers) + grown for body in model.bodies)
    sets = [*others, *((RIGID_BODY, data) for data in described)]
    parts = [packed("i", len(sets))]
    for kind, data in sets:
        parts.append(packed("ii", kind, len(data)) if version >= SIZED else packed("i", kind))
        parts.append(data)
    return b"".join(parts)


def _packed_body(body: BodyName, version: Version, markers: int) -> bytes:
    parts = [packed_name(body.name), packed("ii3f", body.id, -1, 0.0, 0.0, 0.0)]
    if version >= (4, 2):
        parts.append(packed("4f", 0.0, 0.0, 0.0, 1.0))
    if version >= (3, 0):
        parts.append(packed(f"i{3 * markers}f", markers, *[0.01] * (3 * markers)))
        parts.append(packed(f"{markers}i", *range(1, markers + 1)))
    if version >= (4, 0):
        parts.extend(packed_name(f"Marker{index + 1}") for index in range(markers))
    return b"".join(parts)

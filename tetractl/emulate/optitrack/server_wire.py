"""NatNet as a server has it: a client's messages are read, its answers and frames packed."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from tetractl.lab.cameras.optitrack.cursor import packed, packed_name
from tetractl.lab.cameras.optitrack.frame import SIZED
from tetractl.lab.cameras.optitrack.messages import (
    OLDEST,
    Bare,
    BodyName,
    Connect,
    EchoRequest,
    EchoResponse,
    Message,
    MessageKind,
    ModelDef,
    NatNetFrame,
    Request,
    Response,
    RigidBody,
    ServerInfo,
    Ticks,
    Vec3,
    Version,
)
from tetractl.lab.cameras.optitrack.modeldef import RIGID_BODY
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
from tetractl.lab.errors import WireError

CONNECT_4 = SENDER + 5  # from 4.x clients: u8 subscribed only, bitstream version[4]
MEAN_ERROR_M = 0.0002  # of the markers of a tracked body
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Channels:
    """A force plate or another device: some samples of each channel."""

    id: int
    samples: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class Clutter:
    """The rest of a frame, which our client skips."""

    marker_sets: tuple[tuple[str, tuple[Vec3, ...]], ...] = ()
    other_markers: tuple[Vec3, ...] = ()
    body_markers: tuple[Vec3, ...] = ()  # of every rigid body, before 3.0
    skeletons: tuple[tuple[int, tuple[RigidBody, ...]], ...] = ()
    assets: tuple[tuple[int, tuple[RigidBody, ...], tuple[Vec3, ...]], ...] = ()
    labelled_markers: tuple[tuple[int, Vec3], ...] = ()
    force_plates: tuple[Channels, ...] = ()
    devices: tuple[Channels, ...] = ()


def parse_request(received: bytes) -> Message:
    """Read one datagram of a client; WireError where it cannot be read."""
    kind, payload = split(received)
    match kind:
        case MessageKind.CONNECT if len(payload) < SENDER:  # small clients send only a word
            return Connect(read_text(payload))
        case MessageKind.CONNECT if len(payload) < CONNECT_4:
            return Connect(*read_sender(payload))
        case MessageKind.CONNECT:
            subscribed = payload[SENDER] != 0
            return Connect(*read_sender(payload), subscribed, quad(payload, SENDER + 1))
        case MessageKind.REQUEST:
            return Request(read_text(payload))
        case MessageKind.ECHO_REQUEST:
            return EchoRequest(u64(payload, 0, 8))
        case _:
            return Bare(kind)


def pack_answer(message: Message, version: Version | None = None) -> bytes:
    """Pack one datagram of a server; frames and models need a version from 2.6 to 4.3."""
    match message:
        case NatNetFrame() | ModelDef() if version is None:
            raise WireError("frames and models need a protocol version")
        case NatNetFrame():
            assert version is not None
            return pack_full_frame(message, version)
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
            raise WireError(f"no server sends this: {type(message).__name__}")


def pack_full_frame(frame: NatNetFrame, version: Version, clutter: Clutter | None = None) -> bytes:
    """Pack a frame with all that our client skips; what the version does not have is left out."""
    return datagram(MessageKind.FRAME, pack_frame(frame, version, clutter))


def _server_info(info: ServerInfo) -> bytes:
    payload = sender(info.name, info.app_version, info.natnet_version)
    if info.version < (3, 0):
        return payload
    group = info.group or (0, 0, 0, 0)
    return payload + packed(
        "QH?4B", info.clock_hz or 0, info.data_port or 0, info.multicast, *group
    )


def pack_frame(frame: NatNetFrame, version: Version, clutter: Clutter | None = None) -> bytes:
    """Pack a frame's payload; what the version does not have is left out."""
    if not version.known:
        raise WireError(f"protocol {version} cannot be packed")
    rest = clutter or Clutter()

    def body(body: RigidBody) -> bytes:
        return _body(body, version, rest.body_markers)

    def section(items: Iterable[T], pack: Callable[[T], bytes], since: Version = OLDEST) -> bytes:
        return _section(items, pack, version) if version >= since else b""

    return b"".join(
        (
            packed("i", frame.number),
            section(rest.marker_sets, _marker_set),
            section(rest.other_markers, _vector),
            section(frame.bodies, body),
            section(rest.skeletons, lambda item: packed("i", item[0]) + _counted(item[1], body)),
            section(rest.assets, _asset, SIZED),
            section(rest.labelled_markers, lambda item: _labelled(item, version)),
            section(rest.force_plates, _channels, Version(2, 9)),
            section(rest.devices, _channels, Version(2, 11)),
            _suffix(frame, version),
        )
    )


def _section(items: Iterable[T], pack: Callable[[T], bytes], version: Version) -> bytes:
    parts = [pack(item) for item in items]
    body = b"".join(parts)
    head = packed("ii", len(parts), len(body)) if version >= SIZED else packed("i", len(parts))
    return head + body


def _counted(items: Iterable[T], pack: Callable[[T], bytes]) -> bytes:
    parts = [pack(item) for item in items]
    return packed("i", len(parts)) + b"".join(parts)


def _vector(position: Vec3) -> bytes:
    return packed("3f", *position)


def _marker_set(item: tuple[str, tuple[Vec3, ...]]) -> bytes:
    name, markers = item
    return packed_name(name) + _counted(markers, _vector)


def _body(body: RigidBody, version: Version, markers: tuple[Vec3, ...]) -> bytes:
    parts = [packed("i7f", body.id, *body.position, *body.quaternion)]
    if version < (3, 0):
        parts.append(_counted(markers, _vector))
        parts.append(packed(f"{len(markers)}i", *range(len(markers))))
        parts.append(packed(f"{len(markers)}f", *[0.01] * len(markers)))
    error = MEAN_ERROR_M if body.tracking_valid else 0.0
    parts.append(packed("fH", error, body.tracking_valid))
    return b"".join(parts)


def _asset(item: tuple[int, tuple[RigidBody, ...], tuple[Vec3, ...]]) -> bytes:
    asset, bodies, markers = item
    return (
        packed("i", asset)
        + _counted(bodies, lambda body: _body(body, SIZED, ()))
        + _counted(markers, lambda at: packed("i3ffHf", 1, *at, 0.01, 0, 0.0))
    )


def _labelled(item: tuple[int, Vec3], version: Version) -> bytes:
    marker, position = item
    size = packed("i3ff", marker, *position, 0.01)
    return size + packed("H", 0) + (packed("f", 0.0) if version >= (3, 0) else b"")


def _channels(device: Channels) -> bytes:
    return packed("i", device.id) + _counted(
        device.samples, lambda samples: packed(f"i{len(samples)}f", len(samples), *samples)
    )


def _suffix(frame: NatNetFrame, version: Version) -> bytes:
    """Pack timecode, latency and time stamp as zeros, ticks and params as they are."""
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
    """Pack the payload: `others` (type, bytes) first, then every body with `markers` markers.

    `grown` closes each body's description: what a newer protocol has added to it.
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

"""Reads the messages of NatNet clients, and packs a server's answers and frames."""

from collections.abc import Sequence
from random import Random

from tetractl.core.errors import WireError
from tetractl.lab.cameras.optitrack.natnet_messages import (
    NEWEST,
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
    NatNetRequest,
    Response,
    RigidBody,
    ServerInfo,
    Ticks,
    Vec3,
    Version,
)
from tetractl.lab.cameras.optitrack.payloads import RIGID_BODY, SIZED, packed, packed_name
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

CONNECT_4 = SENDER + 5  # from 4.x clients: u8 subscribed only, bitstream version[4]
GROWN = bytes(24)  # extra bytes in descriptions of bodies above protocol 4.3
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
        case NatNetFrame() if version is not None:
            return datagram(MessageKind.FRAME, pack_frame(message, version))
        case ModelDef() if version is not None:
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


def pack_any(message: Message, version: Version) -> bytes:
    """Pack a message in a protocol version; versions before 2.6 are packed as 2.6, versions after
    4.3 as 4.3.
    """
    if version > NEWEST and isinstance(message, ModelDef):
        return datagram(MessageKind.MODELDEF, pack_modeldef(message, NEWEST, grown=GROWN))
    return pack_answer(message, max(OLDEST, min(version, NEWEST)))


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


def mangle(datagram: bytes, chance: Random) -> bytes:
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

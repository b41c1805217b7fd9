"""Decodes the messages of NatNet clients, and encodes a server's answers and frames."""

from collections.abc import Sequence
from random import Random
from struct import Struct

from tetractl.lab.cameras.optitrack import natnet, wire
from tetractl.lab.cameras.optitrack.payloads import RIGID_BODY, find_layout

REQUESTED_VERSION = Struct("<?4B")
"""Layout of a request of a 4.x client: a flag (subscribed data only) and the wanted version."""
EXTRA_BODY_BYTES = bytes(24)
"""Additional bytes at the end of a rigid body's description in protocols above 4.3."""


def parse_request(received: bytes) -> natnet.ClientMessage:
    """Decode a datagram from a client. Messages of which only the kind matters become `Bare`.

    Raises:
        WireError: If the datagram is invalid.
    """
    kind, payload = wire.split_datagram(received)
    match kind:
        case natnet.MessageKind.CONNECT if not payload:  # from libmotioncapture
            return natnet.Connect(natnet.OLDEST)
        case natnet.MessageKind.CONNECT if len(payload) <= wire.SENDER.size:
            return natnet.Connect(wire.read_sender(payload)[1])
        case natnet.MessageKind.CONNECT:
            _, *version = wire.unpack_fields(REQUESTED_VERSION, payload[wire.SENDER.size :])
            return natnet.Connect(natnet.Version(*version[:2]), pinned=True)
        case natnet.MessageKind.REQUEST:
            return natnet.NatNetRequest(wire.read_text(payload))
        case natnet.MessageKind.ECHO_REQUEST:
            return natnet.EchoRequest(*wire.unpack_fields(Struct("<Q"), payload))
        case _:
            return natnet.BareMessage(kind)


def pack_answer(message: natnet.ServerMessage, version: natnet.Version = natnet.NEWEST) -> bytes:
    """Encode a datagram of the server.

    Versions before 2.6 are encoded as 2.6. Versions after 4.3 are encoded as 4.3 with longer
    descriptions of rigid bodies.

    Args:
        message: The message.
        version: Version of the protocol.
    """
    version = max(version, natnet.OLDEST)
    match message:
        case natnet.NatNetFrame():
            return wire.pack_datagram(natnet.MessageKind.FRAME, pack_frame(message, version))
        case natnet.ModelDef():
            extra_bytes = EXTRA_BODY_BYTES if version > natnet.NEWEST else b""
            return wire.pack_datagram(
                natnet.MessageKind.MODELDEF,
                pack_modeldef(message, version, extra_bytes=extra_bytes),
            )
        case natnet.ServerInfo(name, own, clock_hz, port):
            info = wire.SERVER_INFO.pack(clock_hz, port) if own >= (3, 0) else b""
            return wire.pack_datagram(
                natnet.MessageKind.SERVER_INFO, wire.pack_sender(name, own) + info
            )
        case natnet.Response(payload):
            return wire.pack_datagram(natnet.MessageKind.RESPONSE, payload)
        case natnet.EchoResponse(client, server):
            return wire.pack_datagram(
                natnet.MessageKind.ECHO_RESPONSE, wire.ECHO.pack(client, server)
            )
        case natnet.BareMessage(kind):
            return wire.pack_datagram(kind, b"")


def pack_frame(frame: natnet.NatNetFrame, version: natnet.Version) -> bytes:
    """Encode the payload of a frame: its rigid bodies, and all other sections empty."""
    layout = find_layout(version)
    empty = section([], version)
    bodies = [packed_body(body, version) for body in frame.bodies]
    # skeletons, assets, labelled markers, channels
    after = 2 + layout.has_sizes + layout.channel_section_count
    parts = wire.pack_fields("i", frame.number), empty * 2, section(bodies, version), empty * after
    return b"".join((*parts, suffix(frame, version)))


def section(parts: Sequence[bytes], version: natnet.Version) -> bytes:
    """Encode a section of a frame: the number of elements, then the elements.

    `parts` are the encoded elements. In versions with sized sections, their size in bytes follows
    the number of elements.
    """
    size = sum(map(len, parts))
    head = wire.pack_fields("i", len(parts))
    if find_layout(version).has_sizes:
        head += wire.pack_fields("i", size)
    return head + b"".join(parts)


def packed_body(body: natnet.RigidBody, version: natnet.Version, markers: int = 0) -> bytes:
    """Encode a rigid body of a frame.

    Args:
        body: The rigid body.
        version: Version of the protocol.
        markers: Number of its markers, which are only encoded in versions before 3.0.
    """
    error = 0.0002 if body.tracking_valid else 0.0  # mean error of its markers [m]
    listed = (
        b""
        if find_layout(version).has_exposure_time
        else wire.pack_fields("i", markers) + bytes(20 * markers)
    )
    pose = wire.pack_fields("i7f", body.id, *body.position, *body.quaternion)
    return pose + listed + wire.pack_fields("fH", error, body.tracking_valid)


def suffix(frame: natnet.NatNetFrame, version: natnet.Version) -> bytes:
    """Encode the suffix of a frame: exposure time and parameters. All other times are 0.

    An unknown exposure time is 0 as well.
    """
    layout = find_layout(version)
    times = [0] * (len(layout.suffix.format) - 3)
    if layout.has_exposure_time:
        times[3] = frame.exposure or 0
    return wire.pack_fields(layout.suffix.format[1:], *times, frame.params, 0)


def pack_modeldef(
    model: natnet.ModelDef,
    version: natnet.Version,
    other_sets: Sequence[tuple[int, bytes]] = (),
    markers: int = 0,
    extra_bytes: bytes = b"",
) -> bytes:
    """Encode the payload of a MODELDEF message: other data sets, and then every rigid body.

    Args:
        model: The rigid bodies.
        version: Version of the protocol.
        other_sets: Other data sets, each with its type and its bytes.
        markers: Number of markers of each rigid body.
        extra_bytes: Bytes appended to each description, as in a later version of the protocol.
    """
    described = (_packed_body(*body, version, markers) + extra_bytes for body in model.bodies)
    sets = [*other_sets, *((RIGID_BODY, data) for data in described)]
    parts = [wire.pack_fields("i", len(sets))]
    is_sized = find_layout(version).has_sizes
    for kind, data in sets:
        head = wire.pack_fields("ii", kind, len(data)) if is_sized else wire.pack_fields("i", kind)
        parts += [head, data]
    return b"".join(parts)


def _packed_body(name: str, number: int, version: natnet.Version, markers: int) -> bytes:
    """Encode the description of a rigid body."""
    parts = [wire.pack_name(name), wire.pack_fields("ii3f", number, -1, 0.0, 0.0, 0.0)]
    if version >= (4, 2):
        parts.append(wire.pack_fields("4f", 0.0, 0.0, 0.0, 1.0))
    if version >= (3, 0):
        parts.append(wire.pack_fields(f"i{3 * markers}f", markers, *[0.01] * (3 * markers)))
        parts.append(wire.pack_fields(f"{markers}i", *range(1, markers + 1)))
    if version >= (4, 0):
        parts.extend(wire.pack_name(f"Marker{index + 1}") for index in range(markers))
    return b"".join(parts)


def mangle(datagram: bytes, random_generator: Random) -> bytes:
    """Return a copy of a datagram that is damaged in one of five random ways.

    It is truncated, extended, replaced by noise, or one of its fields is changed.
    """
    match random_generator.randrange(5):
        case 0:
            return datagram[: random_generator.randrange(len(datagram))]
        case 1:
            return datagram + bytes(random_generator.randrange(1, 20))
        case 2:
            return datagram[:2] + (len(datagram) + 7).to_bytes(2, "little") + datagram[4:]
        case 3:  # an impossible number of bodies
            return datagram[:8] + b"\xff\xff\xff\x7f" + datagram[12:]
        case _:
            return random_generator.randbytes(random_generator.randrange(1, 1400))

"""Decode the NatNet datagrams of a camera server, and encode the messages of a client."""

import struct
from typing import Any

from tetractl.core.errors import WireError
from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.payloads import NAME_MAX, parse_frame, parse_modeldef

HEADER = struct.Struct("<HH")
"""Layout of a datagram's header: message id, number of payload bytes."""
DATAGRAM_MAX = 65_507
"""Maximum payload of a UDP datagram over IPv4 [bytes]."""
SENDER_FIELDS = "256s4B4B"
"""Layout of the sender's description: name, application version, NatNet version."""
SENDER = struct.Struct("<" + SENDER_FIELDS)
SERVER_INFO = struct.Struct("<QH5x")
"""Layout of SERVERINFO after the sender: clock rate, data port. The multicast group is not read."""
ECHO = struct.Struct("<QQ")
"""Layout of an echo: the client's time and the server's."""
TEXT_MAX = 256
"""Maximum length of the text in a field of a request or a sender [bytes]."""


def parse_datagram(datagram: bytes, version: natnet.Version | None = None) -> natnet.ServerMessage:
    """Decode one datagram from a camera server.

    Args:
        datagram: The whole datagram.
        version: The protocol version that SERVERINFO reported or CONNECT requested. Only frames and
            models need it.

    Raises:
        WireError: If the datagram cannot be read. Nothing else is raised.
    """
    message_kind, payload = split_datagram(datagram)
    match message_kind:
        case natnet.MessageKind.FRAME:
            return parse_frame(payload, _require_version(version, message_kind))
        case natnet.MessageKind.MODELDEF:
            return parse_modeldef(payload, _require_version(version, message_kind))
        case natnet.MessageKind.SERVER_INFO:
            return _parse_server_info(payload)
        case natnet.MessageKind.RESPONSE:
            return natnet.Response(payload)
        case natnet.MessageKind.ECHO_RESPONSE:
            return natnet.EchoResponse(*unpack_fields(ECHO, payload))
        case _:
            return natnet.BareMessage(message_kind)


def _require_version(
    version: natnet.Version | None, message_kind: natnet.MessageKind
) -> natnet.Version:
    """Return the protocol version, which is needed to read a kind of message.

    Raises:
        WireError: If the version is unknown.
    """
    if version is None:
        raise WireError(f"{message_kind.name} received before the protocol version is known")
    return version


def _parse_server_info(payload: bytes) -> natnet.ServerInfo:
    """Decode SERVERINFO. Before NatNet 3.0, it contains no clock rate and no port."""
    name, reported_version = read_sender(payload)
    if reported_version < (3, 0):
        return natnet.ServerInfo(name, reported_version, 0, 0)
    info_payload = payload[SENDER.size : SENDER.size + SERVER_INFO.size]
    return natnet.ServerInfo(name, reported_version, *unpack_fields(SERVER_INFO, info_payload))


def pack_message(message: natnet.ClientMessage) -> bytes:
    """Encode a client's message to the camera server as one datagram.

    Raises:
        WireError: If a value does not fit its field.
    """
    match message:
        case natnet.Connect(version, pinned):
            bitstream = pack_fields("?4B", False, *version, 0, 0) if pinned else b""
            return pack_datagram(
                natnet.MessageKind.CONNECT, pack_sender("tetractl", version) + bitstream
            )
        case natnet.NatNetRequest(command):
            return pack_datagram(natnet.MessageKind.REQUEST, pack_name(command))
        case natnet.EchoRequest(host_ns):
            return pack_datagram(natnet.MessageKind.ECHO_REQUEST, pack_fields("Q", host_ns))
        case natnet.BareMessage(message_kind):
            size = SENDER.size if message_kind is natnet.MessageKind.KEEPALIVE else 1
            return pack_datagram(message_kind, bytes(size))


def split_datagram(datagram: bytes) -> tuple[natnet.MessageKind, bytes]:
    """Split a datagram into the kind of its message and its payload.

    Raises:
        WireError: If the header is wrong.
    """
    if len(datagram) < HEADER.size:
        raise WireError(f"a datagram of {len(datagram)} bytes is too short")
    code, size = HEADER.unpack_from(datagram)
    payload = bytes(datagram[HEADER.size :])
    if size != len(payload):
        raise WireError(f"the header states {size} bytes, but {len(payload)} were received")
    try:
        return natnet.MessageKind(code), payload
    except ValueError:
        raise WireError(f"unknown message id {code}") from None


def pack_datagram(message_kind: natnet.MessageKind, payload: bytes) -> bytes:
    """Put a header in front of a payload.

    Raises:
        WireError: If the payload is too long for a datagram.
    """
    if len(payload) + HEADER.size > DATAGRAM_MAX:
        raise WireError(f"a payload of {len(payload)} bytes does not fit in a datagram")
    return pack_fields("HH", message_kind, len(payload)) + payload


def read_number(response: natnet.Response, layout: str) -> float:
    """Read a response that consists of one number.

    Args:
        response: The server's response.
        layout: "i" for a 32-bit integer, such as the answer to `UpAxis`, or "f" for a 32-bit float.
    """
    return unpack_fields(struct.Struct(f"<{layout}"), response.payload)[0]


def unpack_fields(layout: struct.Struct, payload: bytes) -> tuple[Any, ...]:
    """Unpack the fields of a payload.

    Raises:
        WireError: If the payload's size differs from the size of the layout.
    """
    if len(payload) != layout.size:
        raise WireError(f"a payload has {len(payload)} bytes, but {layout.size} are expected")
    return layout.unpack(payload)


def pack_fields(layout: str, *values: Any) -> bytes:
    """Pack values in little-endian order.

    Args:
        layout: Format of the values, as in `struct`, without a byte order.
        values: The values.

    Raises:
        WireError: If a value does not fit its field.
    """
    try:
        return struct.pack("<" + layout, *values)
    except (struct.error, OverflowError) as error:
        raise WireError(f"cannot pack {layout}: {error}") from None


def pack_name(name: str) -> bytes:
    """Encode a name in UTF-8, and append the NUL that ends it.

    Raises:
        WireError: If the name is longer than NAME_MAX bytes or contains a NUL.
    """
    encoded = name.encode("utf-8", "replace")
    if len(encoded) > NAME_MAX or b"\0" in encoded:
        raise WireError(f"a name has at most {NAME_MAX} bytes and no NUL, unlike {name[:40]!r}")
    return encoded + b"\0"


def pack_sender(name: str, version: natnet.Version) -> bytes:
    """Pack the name and protocol version of a sender, which open CONNECT and SERVERINFO."""
    return pack_fields(SENDER_FIELDS, pack_name(name), 0, 1, 0, 0, *version, 0, 0)


def read_sender(payload: bytes) -> tuple[str, natnet.Version]:
    """Read the name and the protocol version of the program that sent a message.

    Raises:
        WireError: If the payload is too short.
    """
    name, *versions = unpack_fields(SENDER, payload[: SENDER.size])
    return read_text(name), natnet.Version(*versions[4:6])


def read_text(field: bytes) -> str:
    """Read the text up to the first NUL, or up to the end if there is none.

    Raises:
        WireError: If the text has more than TEXT_MAX bytes.
    """
    content = field.partition(b"\0")[0]
    if len(content) > TEXT_MAX:
        raise WireError("the text is too long for its field")
    return content.decode("utf-8", "replace")

"""Parses a server's NatNet datagrams, and packs a client's messages."""

import struct

from tetractl.core.errors import WireError
from tetractl.lab.cameras.optitrack.natnet_messages import (
    Bare,
    Connect,
    EchoRequest,
    EchoResponse,
    Message,
    MessageKind,
    NatNetRequest,
    Quad,
    Response,
    ServerInfo,
    Version,
)
from tetractl.lab.cameras.optitrack.payloads import packed, packed_name, parse_frame, parse_modeldef

HEADER = 4  # u16 message id, u16 payload bytes
DATAGRAM_MAX = 65_507
SENDER = 264  # name[256], application version[4], NatNet version[4]
SERVER_INFO = SENDER + 15  # from 3.0: u64 clock, u16 data port, u8 multicast, group[4]


def parse(datagram: bytes, version: Version | None = None) -> Message:
    """Read one datagram of a server; WireError, and no other error, if it cannot be read.

    `version` is the protocol version that SERVERINFO reported or CONNECT requested; only frames and
    models need it.
    """
    kind, payload = split(datagram)
    match kind:
        case MessageKind.FRAME | MessageKind.MODELDEF:
            if version is None:
                raise WireError(f"{kind.name} received before the protocol version is known")
            read = parse_frame if kind is MessageKind.FRAME else parse_modeldef
            return read(payload, version)
        case MessageKind.SERVER_INFO:
            return _server_info(payload)
        case MessageKind.RESPONSE:
            return Response(payload)
        case MessageKind.ECHO_RESPONSE:
            return EchoResponse(u64(payload, 0, 16), u64(payload, 8, 16))
        case _:
            return Bare(kind)


def pack(message: Message) -> bytes:
    """Pack one datagram of a client; WireError for a message that only a server sends."""
    match message:
        case Connect():
            payload = sender(message.name, message.app_version, message.natnet_version)
            if message.bitstream is not None:
                payload += packed("?4B", message.subscribed_only, *message.bitstream)
            return datagram(MessageKind.CONNECT, payload)
        case NatNetRequest(text):
            return datagram(MessageKind.REQUEST, packed_name(text))
        case EchoRequest(client):
            return datagram(MessageKind.ECHO_REQUEST, packed("Q", client))
        case Bare(MessageKind.KEEPALIVE):
            return datagram(MessageKind.KEEPALIVE, bytes(SENDER))
        case Bare(MessageKind.REQUEST_MODELDEF | MessageKind.DISCONNECT as kind):
            return datagram(kind, b"\0")
        case _:
            raise WireError(f"a client does not send {type(message).__name__}")


def split(datagram: bytes) -> tuple[MessageKind, bytes]:
    """Return a datagram's kind and payload; WireError if its header is wrong."""
    if len(datagram) < HEADER:
        raise WireError(f"a datagram of {len(datagram)} bytes is too short")
    code = int.from_bytes(datagram[:2], "little")
    size = int.from_bytes(datagram[2:4], "little")
    payload = bytes(datagram[HEADER:])
    if size != len(payload):
        raise WireError(f"the header states {size} bytes, but {len(payload)} were received")
    try:
        return MessageKind(code), payload
    except ValueError:
        raise WireError(f"unknown message id {code}") from None


def datagram(kind: MessageKind, payload: bytes) -> bytes:
    """Pack a payload into a datagram of a kind; WireError if it is too long."""
    if len(payload) + HEADER > DATAGRAM_MAX:
        raise WireError(f"a payload of {len(payload)} bytes does not fit in a datagram")
    return packed("HH", kind, len(payload)) + payload


def response_int(response: Response) -> int:
    """Read a response that is one i32, such as the response to `UpAxis`."""
    if len(response.payload) != 4:
        raise WireError(f"the server's reply has {len(response.payload)} bytes; a number has 4")
    return int.from_bytes(response.payload, "little", signed=True)


def response_float(response: Response) -> float:
    """Read a response that is one f32, such as the response to `FrameRate`."""
    if len(response.payload) != 4:
        raise WireError(f"the server's reply has {len(response.payload)} bytes; a number has 4")
    return struct.unpack("<f", response.payload)[0]


def _server_info(payload: bytes) -> ServerInfo:
    name, app, natnet = read_sender(payload)
    if natnet[0] < 3:
        return ServerInfo(name, app, natnet)
    if len(payload) < SERVER_INFO:
        raise WireError(
            f"SERVERINFO of protocol {natnet[0]}.{natnet[1]} has {len(payload)} bytes, "
            f"not {SERVER_INFO} or more"
        )
    clock = int.from_bytes(payload[SENDER : SENDER + 8], "little")
    port = int.from_bytes(payload[SENDER + 8 : SENDER + 10], "little")
    multicast = payload[SENDER + 10] != 0
    return ServerInfo(name, app, natnet, clock, port, multicast, quad(payload, SENDER + 11))


def sender(name: str, app: Quad, natnet: Quad) -> bytes:
    """Pack the sender's name and versions, with which CONNECT and SERVERINFO begin."""
    return packed_name(name).ljust(256, b"\0") + packed("4B4B", *app, *natnet)


def read_sender(payload: bytes) -> tuple[str, Quad, Quad]:
    """Read the sender's name and versions, with which CONNECT and SERVERINFO begin."""
    if len(payload) < SENDER:
        raise WireError(f"the sender's name and versions have {SENDER} bytes, not {len(payload)}")
    return read_text(payload[:256]), quad(payload, 256), quad(payload, 260)


def quad(payload: bytes, at: int) -> Quad:
    """Return the four bytes at an offset, such as an address or a version."""
    a, b, c, d = payload[at : at + 4]
    return a, b, c, d


def read_text(payload: bytes) -> str:
    """Read text up to the first NUL, or to the end if there is none."""
    raw = payload[:257].partition(b"\0")[0]
    if len(raw) > 256:
        raise WireError("the text is too long for its field")
    return raw.decode("utf-8", "replace")


def u64(payload: bytes, at: int, size: int) -> int:
    """Read an unsigned 64-bit integer at an offset of a payload, which must have `size` bytes."""
    if len(payload) != size:
        raise WireError(f"a payload of {size} bytes expected, not of {len(payload)}")
    return int.from_bytes(payload[at : at + 8], "little")

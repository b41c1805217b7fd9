"""Everything but frames and models: connecting, commands, the clock, keeping alive."""

import struct

from tetractl.lab.cameras.optitrack.cursor import NAME_MAX, packed
from tetractl.lab.cameras.optitrack.messages import (
    Bare,
    Connect,
    EchoRequest,
    EchoResponse,
    Message,
    MessageKind,
    Quad,
    Request,
    Response,
    ServerInfo,
    Text,
)
from tetractl.lab.errors import WireError

SENDER = 264  # name[256], application version[4], NatNet version[4]
SERVER_INFO = SENDER + 15  # from 3.0: u64 clock, u16 data port, u8 multicast, group[4]
CONNECT_4 = SENDER + 5  # from 4.x clients: u8 subscribed only, bitstream version[4]


def parse_handshake(kind: MessageKind, payload: bytes) -> Message:
    """Read any message that needs no protocol version."""
    match kind:
        case MessageKind.CONNECT:
            return _connect(payload)
        case MessageKind.SERVER_INFO:
            return _server_info(payload)
        case MessageKind.REQUEST:
            return Request(_text(payload))
        case MessageKind.TEXT:
            return Text(_text(payload, len(payload)))
        case MessageKind.RESPONSE:
            return Response(payload)
        case MessageKind.ECHO_REQUEST:
            return EchoRequest(_u64(payload, 0, 8))
        case MessageKind.ECHO_RESPONSE:
            return EchoResponse(_u64(payload, 0, 16), _u64(payload, 8, 16))
        case _:
            return Bare(kind)


def pack_handshake(message: Message) -> tuple[MessageKind, bytes]:
    """Pack any message that needs no protocol version."""
    match message:
        case Connect():
            payload = _sender(message.name, message.app_version, message.natnet_version)
            if message.bitstream is not None:
                payload += packed("?4B", message.subscribed_only, *message.bitstream)
            return MessageKind.CONNECT, payload
        case ServerInfo():
            return MessageKind.SERVER_INFO, _packed_server_info(message)
        case Request(text):
            return MessageKind.REQUEST, _packed_text(text, NAME_MAX)
        case Text(text):
            return MessageKind.TEXT, _packed_text(text, 65_000)
        case Response(payload):
            return MessageKind.RESPONSE, payload
        case EchoRequest(client):
            return MessageKind.ECHO_REQUEST, packed("Q", client)
        case EchoResponse(client, server):
            return MessageKind.ECHO_RESPONSE, packed("QQ", client, server)
        case Bare(MessageKind.KEEPALIVE):
            return MessageKind.KEEPALIVE, bytes(SENDER)
        case Bare(
            MessageKind.REQUEST_MODELDEF | MessageKind.REQUEST_FRAME | MessageKind.DISCONNECT
        ) as bare:
            return bare.kind, b"\0"
        case Bare(MessageKind.UNRECOGNIZED):
            return MessageKind.UNRECOGNIZED, b""
        case _:
            raise WireError(f"not a handshake message: {type(message).__name__}")


def response_int(response: Response) -> int:
    """Read a response of one i32, such as that to `UpAxis`."""
    if len(response.payload) != 4:
        raise WireError(f"a number has 4 bytes, not {len(response.payload)}")
    return int.from_bytes(response.payload, "little", signed=True)


def response_float(response: Response) -> float:
    """Read a response of one f32, such as that to `FrameRate`."""
    if len(response.payload) != 4:
        raise WireError(f"a number has 4 bytes, not {len(response.payload)}")
    return struct.unpack("<f", response.payload)[0]


def _connect(payload: bytes) -> Connect:
    if len(payload) < SENDER:  # small clients send only a word
        return Connect(_text(payload))
    name, app, natnet = _read_sender(payload)
    if len(payload) < CONNECT_4:
        return Connect(name, app, natnet)
    return Connect(name, app, natnet, payload[SENDER] != 0, _quad(payload, SENDER + 1))


def _server_info(payload: bytes) -> ServerInfo:
    if len(payload) < SENDER:
        raise WireError(f"SERVERINFO of {len(payload)} bytes")
    name, app, natnet = _read_sender(payload)
    if natnet[0] < 3:
        return ServerInfo(name, app, natnet)
    if len(payload) < SERVER_INFO:
        raise WireError(f"SERVERINFO {natnet[0]}.{natnet[1]} of {len(payload)} bytes")
    clock = int.from_bytes(payload[SENDER : SENDER + 8], "little")
    port = int.from_bytes(payload[SENDER + 8 : SENDER + 10], "little")
    multicast = payload[SENDER + 10] != 0
    return ServerInfo(name, app, natnet, clock, port, multicast, _quad(payload, SENDER + 11))


def _packed_server_info(info: ServerInfo) -> bytes:
    payload = _sender(info.name, info.app_version, info.natnet_version)
    if info.version < (3, 0):
        return payload
    group = info.group or (0, 0, 0, 0)
    return payload + packed(
        "QH?4B", info.clock_hz or 0, info.data_port or 0, info.multicast, *group
    )


def _read_sender(payload: bytes) -> tuple[str, Quad, Quad]:
    return _text(payload[:256]), _quad(payload, 256), _quad(payload, 260)


def _sender(name: str, app: Quad, natnet: Quad) -> bytes:
    raw = _packed_text(name, NAME_MAX)
    return raw.ljust(256, b"\0") + packed("4B4B", *app, *natnet)


def _quad(payload: bytes, at: int) -> Quad:
    a, b, c, d = payload[at : at + 4]
    return a, b, c, d


def _text(payload: bytes, limit: int = 256) -> str:
    """Read text up to its NUL, or to the end; after the NUL there may be anything."""
    raw = payload[: limit + 1].partition(b"\0")[0]
    if len(raw) > limit:
        raise WireError("text too long")
    return raw.decode("utf-8", "replace")


def _packed_text(text: str, limit: int) -> bytes:
    raw = text.encode("utf-8", "replace")
    if len(raw) > limit or b"\0" in raw:
        raise WireError(f"not a text for the wire: {text[:40]!r}")
    return raw + b"\0"


def _u64(payload: bytes, at: int, size: int) -> int:
    if len(payload) != size:
        raise WireError(f"{size} bytes expected, not {len(payload)}")
    return int.from_bytes(payload[at : at + 8], "little")

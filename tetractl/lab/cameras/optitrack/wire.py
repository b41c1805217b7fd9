"""Parses a server's NatNet datagrams, packs a client's messages, and decides which datagrams come
from the server, by its address and two of its ports.

Answers come from the port that commands are sent to. Frames come from one other port: in unicast
the port that SERVERINFO reports (from 3.0 on), otherwise the port of the first readable frame.
NatNet does not authenticate senders: packets from the server's address and port are accepted.
"""

import struct
from collections import Counter
from typing import Any, NamedTuple

from tetractl.core.errors import WireError
from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.payloads import NAME_MAX, parse_frame, parse_modeldef

HEADER = struct.Struct("<HH")  # message id, payload bytes
DATAGRAM_MAX = 65_507  # largest payload of a UDP datagram over IPv4 [bytes]
SENDER = struct.Struct("<256s4B4B")  # name, application version, NatNet version
SERVER_INFO = struct.Struct("<QH5x")  # clock, data port; multicast and its group are not read
ECHO = struct.Struct("<QQ")  # our time and the server's
ANSWERS = frozenset(natnet.MessageKind) - {natnet.MessageKind.FRAME}


class Sender(NamedTuple):
    """The origin of datagrams: address and port, and whether they are frames or answers."""

    host: str
    port: int
    frames: bool

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


class Senders:
    """Admits the datagrams of one server and counts all others by their sender."""

    def __init__(self, server: str, command_port: int) -> None:
        self.server = server
        self.command_port = command_port
        self.frames_port: int | None = None
        self.refused: Counter[Sender] = Counter()
        self.refused_frame = b""  # the newest refused frame

    def admit(self, datagram: bytes, host: str, port: int) -> bool:
        """Return whether a datagram comes from the address and port for its kind.

        Until the frames' port is known, frames are admitted from every port of the server. A
        datagram of unknown kind counts as a frame, since it may be a damaged frame.
        """
        frame = int.from_bytes(datagram[:2], "little") not in ANSWERS
        expected = (self.frames_port or port) if frame else self.command_port
        if host == self.server and port == expected:
            return True
        sender = Sender(host, port, frame)
        # forged senders must not fill the memory
        if sender in self.refused or len(self.refused) < 64:
            self.refused[sender] += 1
        if frame:
            self.refused_frame = datagram
        return False

    def pin(self, port: int) -> None:
        """Admit frames only from this port from now on, unless it is 0; once a port is known, calls
        do nothing."""
        self.frames_port = self.frames_port or port

    def most(self, frames: bool) -> tuple[Sender, int] | None:
        """Return the sender of the most refused frames (if not `frames`: answers) and their number;
        None if none was refused.
        """
        senders = self.refused.most_common()
        return next((sender for sender in senders if sender[0].frames is frames), None)


def parse(datagram: bytes, version: natnet.Version | None = None) -> natnet.ServerMessage:
    """Read one datagram of a server; WireError, and no other error, if it cannot be read.

    `version` is the protocol version that SERVERINFO reported or CONNECT requested; only frames and
    models need it.
    """
    kind, payload = split(datagram)
    match kind:
        case natnet.MessageKind.FRAME | natnet.MessageKind.MODELDEF:
            if version is None:
                raise WireError(f"{kind.name} received before the protocol version is known")
            read = parse_frame if kind is natnet.MessageKind.FRAME else parse_modeldef
            return read(payload, version)
        case natnet.MessageKind.SERVER_INFO:
            name, version = read_sender(payload)
            if version < (3, 0):
                return natnet.ServerInfo(name, version, 0, 0)
            rest = payload[SENDER.size : SENDER.size + SERVER_INFO.size]
            return natnet.ServerInfo(name, version, *unpacked(SERVER_INFO, rest))
        case natnet.MessageKind.RESPONSE:
            return natnet.Response(payload)
        case natnet.MessageKind.ECHO_RESPONSE:
            return natnet.EchoResponse(*unpacked(ECHO, payload))
        case _:
            return natnet.Bare(kind)


def pack(message: natnet.ClientMessage) -> bytes:
    """Pack one datagram of a client."""
    match message:
        case natnet.Connect(version, pinned):
            bitstream = packed("?4B", False, *version, 0, 0) if pinned else b""
            return datagram(natnet.MessageKind.CONNECT, sender("tetractl", version) + bitstream)
        case natnet.NatNetRequest(text):
            return datagram(natnet.MessageKind.REQUEST, packed_name(text))
        case natnet.EchoRequest(client):
            return datagram(natnet.MessageKind.ECHO_REQUEST, packed("Q", client))
        case natnet.Bare(kind):
            size = SENDER.size if kind is natnet.MessageKind.KEEPALIVE else 1
            return datagram(kind, bytes(size))


def split(datagram: bytes) -> tuple[natnet.MessageKind, bytes]:
    """Return a datagram's kind and payload; WireError if its header is wrong."""
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


def datagram(kind: natnet.MessageKind, payload: bytes) -> bytes:
    """Pack a payload into a datagram of a kind; WireError if it is too long."""
    if len(payload) + HEADER.size > DATAGRAM_MAX:
        raise WireError(f"a payload of {len(payload)} bytes does not fit in a datagram")
    return packed("HH", kind, len(payload)) + payload


def number_in(response: natnet.Response, layout: str) -> float:
    """Read a response that is one number: "i" an i32, as of `UpAxis`, or "f" an f32."""
    return unpacked(struct.Struct(f"<{layout}"), response.payload)[0]


def unpacked(layout: struct.Struct, payload: bytes) -> tuple[Any, ...]:
    """Return the fields of a payload; WireError if its size is another one."""
    if len(payload) != layout.size:
        raise WireError(f"a payload of {layout.size} bytes expected, not of {len(payload)}")
    return layout.unpack(payload)


def packed(layout: str, *values: Any) -> bytes:
    """Pack little-endian values; WireError if one does not fit."""
    try:
        return struct.pack("<" + layout, *values)
    except (struct.error, OverflowError) as error:
        raise WireError(f"cannot pack {layout}: {error}") from None


def packed_name(name: str) -> bytes:
    """Pack a NUL-terminated name."""
    raw = name.encode("utf-8", "replace")
    if len(raw) > NAME_MAX or b"\0" in raw:
        raise WireError(f"a name has at most {NAME_MAX} bytes and no NUL, unlike {name[:40]!r}")
    return raw + b"\0"


def sender(name: str, version: natnet.Version) -> bytes:
    """Pack the sender's name and protocol version, with which CONNECT and SERVERINFO begin."""
    return packed(SENDER.format[1:], packed_name(name), 0, 1, 0, 0, *version, 0, 0)


def read_sender(payload: bytes) -> tuple[str, natnet.Version]:
    """Read the sender's name and protocol version."""
    name, *versions = unpacked(SENDER, payload[: SENDER.size])
    return read_text(name), natnet.Version(*versions[4:6])


def read_text(raw: bytes) -> str:
    """Read text of at most 256 bytes up to the first NUL, or to the end if there is none."""
    raw = raw[: NAME_MAX + 2].partition(b"\0")[0]
    if len(raw) > NAME_MAX + 1:
        raise WireError("the text is too long for its field")
    return raw.decode("utf-8", "replace")

"""NatNet datagrams to messages and back: the one place that knows the header."""

from tetractl.lab.cameras.optitrack.cursor import packed
from tetractl.lab.cameras.optitrack.frame import parse_frame
from tetractl.lab.cameras.optitrack.handshake import pack_handshake, parse_handshake
from tetractl.lab.cameras.optitrack.messages import (
    Clutter,
    Message,
    MessageKind,
    ModelDef,
    NatNetFrame,
    Version,
)
from tetractl.lab.cameras.optitrack.modeldef import pack_modeldef, parse_modeldef
from tetractl.lab.cameras.optitrack.pack import pack_frame
from tetractl.lab.errors import WireError

HEADER = 4  # u16 message id, u16 payload bytes
DATAGRAM_MAX = 65_507


def parse(datagram: bytes, version: Version | None = None) -> Message:
    """Read one datagram.

    Frames and models need the version that SERVERINFO told (or CONNECT pinned); handshake
    messages do not. Raises WireError, and nothing else, whatever the bytes are.
    """
    if len(datagram) < HEADER:
        raise WireError(f"a datagram of {len(datagram)} bytes")
    code = int.from_bytes(datagram[:2], "little")
    size = int.from_bytes(datagram[2:4], "little")
    payload = bytes(datagram[HEADER:])
    if size != len(payload):
        raise WireError(f"the header tells {size} bytes, {len(payload)} came")
    try:
        kind = MessageKind(code)
    except ValueError:
        raise WireError(f"unknown message id {code}") from None
    if kind not in (MessageKind.FRAME, MessageKind.MODELDEF):
        return parse_handshake(kind, payload)
    if version is None:
        raise WireError(f"{kind.name} before the protocol version is known")
    return (parse_frame if kind is MessageKind.FRAME else parse_modeldef)(payload, version)


def pack(message: Message, version: Version | None = None) -> bytes:
    """Pack one datagram; frames and models need a version from 2.5 to 4.3."""
    if isinstance(message, NatNetFrame | ModelDef):
        if version is None:
            raise WireError("frames and models need a protocol version")
        if isinstance(message, NatNetFrame):
            return datagram(MessageKind.FRAME, pack_frame(message, version))
        return datagram(MessageKind.MODELDEF, pack_modeldef(message, version))
    return datagram(*pack_handshake(message))


def pack_full_frame(frame: NatNetFrame, version: Version, clutter: Clutter) -> bytes:
    """Pack a frame together with all that our parser skips."""
    return datagram(MessageKind.FRAME, pack_frame(frame, version, clutter))


def datagram(kind: MessageKind, payload: bytes) -> bytes:
    """Put the header before a payload."""
    if len(payload) + HEADER > DATAGRAM_MAX:
        raise WireError(f"{len(payload)} bytes do not fit in a datagram")
    return packed("HH", kind, len(payload)) + payload

"""Datagrams with something of everything, for every protocol version."""

import struct

import pytest
from tetractl_emulator.optitrack.natnet_server import pack_modeldef, packed_body, section, suffix

from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.payloads import layout_of
from tetractl.lab.cameras.optitrack.wire import datagram, packed, packed_name

NUMBERS = "2.6 2.7 2.9 2.10 2.11 3.0 3.1 4.0 4.1 4.2 4.3"
VERSIONS = [natnet.Version.of(text) for text in NUMBERS.split(" ")]
every_version = pytest.mark.parametrize("version", VERSIONS, ids=str)
BODY = natnet.RigidBody(7, (0.5, 0.25, -1.0), (0.0, 0.0, 0.6, 0.8), True)


def full_frame(version, bodies=(BODY, BODY), params=0):
    """Return a frame with something of every kind; what the version does not have is left out."""
    layout = layout_of(version)
    frame = natnet.NatNetFrame(1234, bodies, params)
    at = packed("3f", *BODY.position)
    body = packed_body(BODY, version, markers=3)
    marker = packed("i3ffH", 1, *BODY.position, 0.01, 0)

    def listed(*parts):
        return packed("i", len(parts)) + b"".join(parts)

    plate = packed("i", 1) + listed(packed("i2f", 2, 1.0, 2.0), packed("i", 0))
    device = packed("i", 2) + listed(packed("if", 1, 3.0))
    asset = packed("i", 5) + listed(body) + listed(*[marker + bytes(4)] * 2)
    sections = [
        [packed_name("green") + listed(at, at), packed_name("all") + listed(*[at] * 5)],
        [at],
        [packed_body(body, version, markers=3) for body in bodies],
        [packed("i", 3) + listed(body, body), packed("i", 4) + listed()],
        *[[asset]] * layout.sized,
        [marker + bytes(4 * layout.timed)] * 2,
        *[[plate], [device]][: layout.channels],
    ]
    parts = b"".join(section(found, version) for found in sections)
    payload = packed("i", frame.number) + parts + suffix(frame, version)
    return datagram(natnet.MessageKind.FRAME, payload)


def full_modeldef(version, awkward=True):
    """Return two rigid bodies behind data sets of every type whose layout is known."""
    text = b"some name\0"
    others = [
        (0, text + struct.pack("<i", 2) + text + text),
        (2, text + struct.pack("<ii", 1, 0)),
        (5, text + bytes(28)),
    ]
    if version >= (3, 0):
        plate = struct.pack("<i", 1) + text + bytes(4 * (2 + 3 + 144 + 12 + 2))
        others += [(3, plate + struct.pack("<i", 1) + text)] * awkward
        others.append((4, struct.pack("<i", 2) + text + text + struct.pack("<iii", 0, 0, 1) + text))
    if version >= (4, 1):
        others += [(6, b"an asset that is stepped over")] * awkward
    model = natnet.ModelDef((("green", 1), ("blü", 2)))
    return model, datagram(
        natnet.MessageKind.MODELDEF, pack_modeldef(model, version, others, markers=3)
    )

"""Sample datagrams with every kind of content, for every protocol version."""

import struct

import pytest
from tetractl_emulator.optitrack.natnet_server import pack_modeldef, packed_body, section, suffix

from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.payloads import find_layout
from tetractl.lab.cameras.optitrack.wire import pack_datagram, pack_fields, pack_name

NUMBERS = "2.6 2.7 2.9 2.10 2.11 3.0 3.1 4.0 4.1 4.2 4.3"
VERSIONS = [natnet.Version.parse(text) for text in NUMBERS.split(" ")]
every_version = pytest.mark.parametrize("version", VERSIONS, ids=str)
BODY = natnet.RigidBody(7, (0.5, 0.25, -1.0), (0.0, 0.0, 0.6, 0.8), True)


def full_frame(version, bodies=(BODY, BODY), params=0):
    """Return a frame with something of every kind; what the version does not have is left out."""
    layout = find_layout(version)
    frame = natnet.NatNetFrame(1234, bodies, params)
    position = pack_fields("3f", *BODY.position)
    body = packed_body(BODY, version, markers=3)
    marker = pack_fields("i3ffH", 1, *BODY.position, 0.01, 0)
    marker_sets = [
        numbered(pack_name("green"), position, position),
        numbered(pack_name("all"), *[position] * 5),
    ]
    skeleton = numbered(pack_fields("i", 3), body, body)
    skeletons = [skeleton, numbered(pack_fields("i", 4))]
    sections = [
        marker_sets,
        [position],  # of an unlabelled marker
        [packed_body(body, version, markers=3) for body in bodies],
        skeletons,
    ]
    if layout.has_sizes:
        markers_of_asset = numbered(b"", marker + bytes(4), marker + bytes(4))
        asset = numbered(pack_fields("i", 5), body) + markers_of_asset
        sections.append([asset])
    labelled_marker = marker + bytes(4 * layout.has_exposure_time)
    sections.append([labelled_marker, labelled_marker])
    analogue = [
        pack_fields("i2f", 2, 1.0, 2.0),
        pack_fields("i", 0),
    ]  # channels of two samples and of none
    force_plate = numbered(pack_fields("i", 1), *analogue)
    device = numbered(pack_fields("i", 2), pack_fields("if", 1, 3.0))
    sections.extend([[force_plate], [device]][: layout.channel_section_count])
    parts = [section(items, version) for items in sections]
    payload = pack_fields("i", frame.number) + b"".join(parts) + suffix(frame, version)
    return pack_datagram(natnet.MessageKind.FRAME, payload)


def numbered(head, *items):
    """A head, the number of items, and these."""
    return head + pack_fields("i", len(items)) + b"".join(items)


def full_modeldef(version):
    """Return two rigid bodies behind data sets of every type whose layout is known."""
    text = b"some name\0"
    others = [
        (0, text + struct.pack("<i", 2) + text + text),
        (2, text + struct.pack("<ii", 1, 0)),
        (5, text + bytes(28)),
    ]
    if version >= (3, 0):
        plate = struct.pack("<i", 1) + text + bytes(4 * (2 + 3 + 144 + 12 + 2))
        others.append((3, plate + struct.pack("<i", 1) + text))
        others.append((4, struct.pack("<i", 2) + text + text + struct.pack("<iii", 0, 0, 1) + text))
    if version >= (4, 1):
        others.append((6, b"an asset that is stepped over"))
    model = natnet.ModelDef((("green", 1), ("blü", 2)))
    return model, pack_datagram(
        natnet.MessageKind.MODELDEF, pack_modeldef(model, version, others, markers=3)
    )

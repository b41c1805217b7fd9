"""Datagrams with something of everything, for every protocol version."""

import struct

import pytest

from tetractl.emulate.optitrack.server_wire import Channels, Clutter, pack_full_frame, pack_modeldef
from tetractl.lab.cameras.optitrack.messages import (
    BodyName,
    MessageKind,
    ModelDef,
    NatNetFrame,
    RigidBody,
    Version,
)
from tetractl.lab.cameras.optitrack.wire import datagram

NUMBERS = "2.6 2.7 2.9 2.10 2.11 3.0 3.1 4.0 4.1 4.2 4.3"
VERSIONS = [Version(*map(int, number.split("."))) for number in NUMBERS.split(" ")]
every_version = pytest.mark.parametrize("version", VERSIONS, ids=str)


def full_frame(version):
    """Return a frame with something of every kind."""
    at = (0.5, 0.25, -1.0)
    body = RigidBody(7, at, (0.0, 0.0, 0.6, 0.8), True)
    clutter = Clutter(
        marker_sets=(("green", (at, at)), ("all", (at,) * 5)),
        other_markers=(at,),
        body_markers=(at, at, at),
        skeletons=((3, (body, body)), (4, ())),
        assets=((5, (body,), (at, at)),),
        labelled_markers=((1, at), (2, at)),
        force_plates=(Channels(1, ((1.0, 2.0), ())),),
        devices=(Channels(2, ((3.0,),)),),
    )
    return pack_full_frame(NatNetFrame(1234, (body, body)), version, clutter)


def full_modeldef(version, awkward=True):
    """Return two rigid bodies behind data sets of every type whose layout is known."""
    text = b"some name\0"
    others = [
        (0, text + struct.pack("<i", 2) + text + text),
        (2, text + struct.pack("<ii", 1, 0)),
        (5, text + bytes(28)),
    ]
    if version >= (3, 0) and awkward:
        plate = struct.pack("<i", 1) + text + bytes(4 * (2 + 3 + 144 + 12 + 2))
        others.append((3, plate + struct.pack("<i", 1) + text))
    if version >= (3, 0):
        others.append((4, struct.pack("<i", 2) + text + text + struct.pack("<iii", 0, 0, 1) + text))
    if version >= (4, 1) and awkward:
        others.append((6, b"an asset that is stepped over"))
    model = ModelDef((BodyName("green", 1), BodyName("blü", 2)))
    return model, datagram(MessageKind.MODELDEF, pack_modeldef(model, version, others, markers=3))

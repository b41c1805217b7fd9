"""Datagrams with something of everything, for every protocol version."""

import struct
from dataclasses import dataclass

import pytest

from tetractl.emulate.optitrack.natnet_server import pack_modeldef, packed_body, section, suffix
from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.payloads import layout_of
from tetractl.lab.cameras.optitrack.wire import datagram, packed, packed_name

NUMBERS = "2.6 2.7 2.9 2.10 2.11 3.0 3.1 4.0 4.1 4.2 4.3"
VERSIONS = [natnet.Version.of(text) for text in NUMBERS.split(" ")]
every_version = pytest.mark.parametrize("version", VERSIONS, ids=str)


Channels = tuple[int, tuple[tuple[float, ...], ...]]
"""The id of a force plate or another device, and some samples of each channel."""


@dataclass(frozen=True, slots=True)
class Clutter:
    """The rest of a frame, which our client skips."""

    marker_sets: tuple[tuple[str, tuple[tuple[float, float, float], ...]], ...] = ()
    other_markers: tuple[tuple[float, float, float], ...] = ()
    body_markers: int = 0  # of every rigid body, before 3.0
    skeletons: tuple[tuple[int, tuple[natnet.RigidBody, ...]], ...] = ()
    assets: tuple[
        tuple[int, tuple[natnet.RigidBody, ...], tuple[tuple[float, float, float], ...]], ...
    ] = ()
    labelled_markers: tuple[tuple[int, tuple[float, float, float]], ...] = ()
    channels: tuple[tuple[Channels, ...], ...] = ((), ())  # of force plates, of other devices


def pack_full_frame(frame, version, rest):
    """Pack a frame with all that a client skips; what the version does not have is left out."""
    layout = layout_of(version)

    def listed(parts):
        return packed("i", len(parts)) + b"".join(parts)

    def vectors(found):
        return [packed("3f", *at) for at in found]

    def bodies(found):
        return [packed_body(body, version, rest.body_markers) for body in found]

    def channels(device):
        number, samples = device
        rows = [packed(f"i{len(row)}f", len(row), *row) for row in samples]
        return packed("i", number) + listed(rows)

    def labelled(marker, at):
        return packed("i3ffH", marker, *at, 0.01, 0) + (packed("f", 0.0) if layout.timed else b"")

    def asset(number, found, markers):
        spots = [packed("i3ffHf", 1, *at, 0.01, 0, 0.0) for at in markers]
        return packed("i", number) + listed(bodies(found)) + listed(spots)

    sections = [
        [packed_name(name) + listed(vectors(at)) for name, at in rest.marker_sets],
        vectors(rest.other_markers),
        bodies(frame.bodies),
        [packed("i", n) + listed(bodies(found)) for n, found in rest.skeletons],
        *([[asset(*each) for each in rest.assets]] if layout.sized else []),
        [labelled(*each) for each in rest.labelled_markers],
        *[[channels(each) for each in of] for of in rest.channels[: layout.channels]],
    ]
    parts = [section(found, version) for found in sections]
    payload = packed("i", frame.number) + b"".join(parts) + suffix(frame, version)
    return datagram(natnet.MessageKind.FRAME, payload)


def full_frame(version):
    """Return a frame with something of every kind."""
    at = (0.5, 0.25, -1.0)
    body = natnet.RigidBody(7, at, (0.0, 0.0, 0.6, 0.8), True)
    clutter = Clutter(
        marker_sets=(("green", (at, at)), ("all", (at,) * 5)),
        other_markers=(at,),
        body_markers=3,
        skeletons=((3, (body, body)), (4, ())),
        assets=((5, (body,), (at, at)),),
        labelled_markers=((1, at), (2, at)),
        channels=(((1, ((1.0, 2.0), ())),), ((2, ((3.0,),)),)),
    )
    return pack_full_frame(natnet.NatNetFrame(1234, (body, body)), version, clutter)


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

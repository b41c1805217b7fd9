"""Datagrams with something of everything, for every protocol version."""

import struct
from dataclasses import dataclass

import pytest

from tetractl.emulate.optitrack.natnet_server import pack_modeldef, packed_body, section, suffix
from tetractl.lab.cameras.optitrack.natnet_messages import (
    MessageKind,
    ModelDef,
    NatNetFrame,
    RigidBody,
    Version,
)
from tetractl.lab.cameras.optitrack.payloads import SIZED
from tetractl.lab.cameras.optitrack.wire import datagram, packed, packed_name

VERSIONS = [Version.of(text) for text in ["3.0", "3.1", "4.0", "4.1", "4.2", "4.3"]]
every_version = pytest.mark.parametrize("version", VERSIONS, ids=str)


@dataclass(frozen=True, slots=True)
class Channels:
    """A force plate or another device: some samples of each channel."""

    id: int
    samples: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class Clutter:
    """The rest of a frame, which our client skips."""

    marker_sets: tuple[tuple[str, tuple[tuple[float, float, float], ...]], ...] = ()
    other_markers: tuple[tuple[float, float, float], ...] = ()
    skeletons: tuple[tuple[int, tuple[RigidBody, ...]], ...] = ()
    assets: tuple[
        tuple[int, tuple[RigidBody, ...], tuple[tuple[float, float, float], ...]], ...
    ] = ()
    labelled_markers: tuple[tuple[int, tuple[float, float, float]], ...] = ()
    force_plates: tuple[Channels, ...] = ()
    devices: tuple[Channels, ...] = ()


def pack_full_frame(frame, version, rest):
    """Pack a frame with all that a client skips; assets only from 4.1 on."""

    def listed(parts):
        return packed("i", len(parts)) + b"".join(parts)

    def vectors(found):
        return [packed("3f", *at) for at in found]

    def channels(device):
        rows = [packed(f"i{len(row)}f", len(row), *row) for row in device.samples]
        return packed("i", device.id) + listed(rows)

    def labelled(marker, at):
        return packed("i3ffHf", marker, *at, 0.01, 0, 0.0)

    def asset(number, found, markers):
        spots = [packed("i3ffHf", 1, *at, 0.01, 0, 0.0) for at in markers]
        return packed("i", number) + listed(list(map(packed_body, found))) + listed(spots)

    sections = [
        [packed_name(name) + listed(vectors(at)) for name, at in rest.marker_sets],
        vectors(rest.other_markers),
        [packed_body(body) for body in frame.bodies],
        [packed("i", n) + listed(list(map(packed_body, found))) for n, found in rest.skeletons],
        *([[asset(*each) for each in rest.assets]] if version >= SIZED else []),
        [labelled(*each) for each in rest.labelled_markers],
        [channels(plate) for plate in rest.force_plates],
        [channels(device) for device in rest.devices],
    ]
    parts = [section(found, version) for found in sections]
    payload = packed("i", frame.number) + b"".join(parts) + suffix(frame, version)
    return datagram(MessageKind.FRAME, payload)


def full_frame(version):
    """Return a frame with something of every kind."""
    at = (0.5, 0.25, -1.0)
    body = RigidBody(7, at, (0.0, 0.0, 0.6, 0.8), True)
    clutter = Clutter(
        marker_sets=(("green", (at, at)), ("all", (at,) * 5)),
        other_markers=(at,),
        skeletons=((3, (body, body)), (4, ())),
        assets=((5, (body,), (at, at)),),
        labelled_markers=((1, at), (2, at)),
        force_plates=(Channels(1, ((1.0, 2.0), ())),),
        devices=(Channels(2, ((3.0,),)),),
    )
    return pack_full_frame(NatNetFrame(1234, (body, body)), version, clutter)


def full_modeldef(version, awkward=True):
    """Return two rigid bodies behind data sets of every type that is stepped over."""
    text = b"some name\0"
    others = [
        (0, text + struct.pack("<i", 2) + text + text),
        (2, text + struct.pack("<ii", 1, 0)),
    ]
    if version >= (4, 1):
        others.append((5, text + bytes(28)))
        others += [(6, b"an asset that is stepped over")] * awkward
    model = ModelDef((("green", 1), ("blü", 2)))
    return model, datagram(MessageKind.MODELDEF, pack_modeldef(model, version, others, markers=3))

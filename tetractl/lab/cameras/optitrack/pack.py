"""FRAMEOFDATA as a server packs it: for the emulated Motive and for tests."""

from collections.abc import Callable, Iterable
from typing import TypeVar

from tetractl.lab.cameras.optitrack.cursor import packed, packed_name
from tetractl.lab.cameras.optitrack.frame import SIZED
from tetractl.lab.cameras.optitrack.messages import (
    OLDEST,
    Channels,
    Clutter,
    NatNetFrame,
    RigidBody,
    Ticks,
    Vec3,
    Version,
)
from tetractl.lab.errors import WireError

T = TypeVar("T")


def pack_frame(frame: NatNetFrame, version: Version, clutter: Clutter | None = None) -> bytes:
    """Pack a frame's payload; what the version does not have is left out."""
    if not version.known:
        raise WireError(f"protocol {version} cannot be packed")
    rest = clutter or Clutter()

    def body(body: RigidBody) -> bytes:
        return _body(body, version, rest.body_markers)

    def section(items: Iterable[T], pack: Callable[[T], bytes], since: Version = OLDEST) -> bytes:
        return _section(items, pack, version) if version >= since else b""

    return b"".join(
        (
            packed("i", frame.number),
            section(rest.marker_sets, _marker_set),
            section(rest.other_markers, _vector),
            section(frame.bodies, body),
            section(rest.skeletons, lambda item: packed("i", item[0]) + _counted(item[1], body)),
            section(rest.assets, _asset, SIZED),
            section(rest.labelled_markers, lambda item: _labelled(item, version)),
            section(rest.force_plates, _channels, Version(2, 9)),
            section(rest.devices, _channels, Version(2, 11)),
            _suffix(frame, version),
        )
    )


def _section(items: Iterable[T], pack: Callable[[T], bytes], version: Version) -> bytes:
    parts = [pack(item) for item in items]
    body = b"".join(parts)
    head = packed("ii", len(parts), len(body)) if version >= SIZED else packed("i", len(parts))
    return head + body


def _counted(items: Iterable[T], pack: Callable[[T], bytes]) -> bytes:
    parts = [pack(item) for item in items]
    return packed("i", len(parts)) + b"".join(parts)


def _vector(position: Vec3) -> bytes:
    return packed("3f", *position)


def _marker_set(item: tuple[str, tuple[Vec3, ...]]) -> bytes:
    name, markers = item
    return packed_name(name) + _counted(markers, _vector)


def _body(body: RigidBody, version: Version, markers: tuple[Vec3, ...]) -> bytes:
    parts = [packed("i7f", body.id, *body.position, *body.quaternion)]
    if version < (3, 0):
        parts.append(_counted(markers, _vector))
        parts.append(packed(f"{len(markers)}i", *range(len(markers))))
        parts.append(packed(f"{len(markers)}f", *[0.01] * len(markers)))
    parts.append(packed("f", body.mean_error))
    if version >= (2, 6):
        parts.append(packed("H", 1 if body.tracking_valid else 0))
    return b"".join(parts)


def _asset(item: tuple[int, tuple[RigidBody, ...], tuple[Vec3, ...]]) -> bytes:
    asset, bodies, markers = item
    return (
        packed("i", asset)
        + _counted(bodies, lambda body: _body(body, SIZED, ()))
        + _counted(markers, lambda at: packed("i3ffHf", 1, *at, 0.01, 0, 0.0))
    )


def _labelled(item: tuple[int, Vec3], version: Version) -> bytes:
    marker, position = item
    size = packed("i3ff", marker, *position, 0.01)
    params = packed("H", 0) if version >= (2, 6) else b""
    return size + params + (packed("f", 0.0) if version >= (3, 0) else b"")


def _channels(device: Channels) -> bytes:
    return packed("i", device.id) + _counted(
        device.samples, lambda samples: packed(f"i{len(samples)}f", len(samples), *samples)
    )


def _suffix(frame: NatNetFrame, version: Version) -> bytes:
    code = packed("II", frame.timecode, frame.subframe)
    if version < (3, 0):
        code = packed("f", frame.latency or 0.0) + code
    if version < (2, 6):
        return code + packed("i", 0)
    stamp = packed("f" if version < (2, 7) else "d", frame.timestamp_s or 0.0)
    ticks = frame.ticks or Ticks(0, 0, 0)
    if version >= (3, 0):
        stamp += packed("3Q", ticks.exposure, ticks.received, ticks.transmit)
    if version >= SIZED:
        stamp += packed("II", *(frame.precision or (0, 0)))
    return code + stamp + packed("Hi", frame.params, 0)

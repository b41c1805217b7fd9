"""The parsers of the emulated lab and of its server's messages, as targets for fuzzing."""

import math
import struct
from collections.abc import Iterator

from tetractl_emulator.optitrack.natnet_server import pack_answer
from tetractl_emulator.script import parse_script

from testkit.paths import SCRIPTS
from testkit.targets import Target, files, only, text
from tetractl.core.errors import SpecError, WireError
from tetractl.core.poses import CameraFrame
from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.natnet import Placement, UpAxis
from tetractl.lab.cameras.optitrack.section import TrackedRobot
from tetractl.lab.cameras.optitrack.stream import (
    AGE_MAX_NS,
    UNITS_SETTING,
    UP_AXIS_SETTING,
    NatNetStream,
)
from tetractl.lab.cameras.optitrack.wire import parse_datagram

VERSIONS = [
    natnet.Version(*v) for v in [(2, 6), (2, 7), (2, 9), (2, 11), (3, 0), (3, 1), (4, 1), (4, 3)]
]
MS = 1_000_000  # ns
ECHOED_NS = 1990 * MS  # when the ECHO that is answered was sent
HZ = 10_000_000  # of the server's clock


def script(data: bytes) -> None:
    with only(SpecError, one_line=False):
        script = parse_script(text(data), "s.yaml")
        assert all(math.isfinite(fault.at) for fault in script.faults)


def sound(frame: CameraFrame) -> None:
    """No number reaches the controller or the log that they cannot hold."""
    for pose in (*frame.poses, *frame.unknown_objects):
        assert pose is None or all(map(math.isfinite, (pose.x, pose.y, pose.heading)))
    assert 0 <= frame.received_ns - frame.sampled_ns <= AGE_MAX_NS


def stream(up: UpAxis | None = None) -> NatNetStream:
    robots = (
        TrackedRobot(name="robot", body="green"),
        TrackedRobot(name="robot", body=12, heading_offset=0.5),
    )
    return NatNetStream(robots, Placement(100.0, 200.0, 0.3, 1000.0), up=up)


def natnet_datagrams(data: bytes) -> None:
    """One byte for a version, then datagrams, cut where their headers say."""
    version = VERSIONS[data[0] % len(VERSIONS)] if data else None
    rest = data[1:]
    for server_version in (version, None):
        with only(WireError):
            parse_datagram(rest, server_version)
    hearing = stream()
    for question in (
        natnet.Connect(),
        natnet.BareMessage(natnet.MessageKind.REQUEST_MODELDEF),
        natnet.EchoRequest(ECHOED_NS),
    ):
        hearing.record_request(question)
    fed = 0
    for datagram in cut_by_headers(rest):
        hearing.record_request(natnet.NatNetRequest((UP_AXIS_SETTING, UNITS_SETTING)[fed % 2]))
        hearing.feed(datagram, 500 * MS * fed)
        if hearing.newest is not None:
            sound(hearing.newest)
        fed += 1
    counts = hearing.counts
    assert counts.frames + counts.unread + counts.unrequested <= fed
    hearing.list_missing_bodies()


def cut_by_headers(data: bytes) -> Iterator[bytes]:
    """Yield the datagrams of which data consist: each begins with 2 bytes and its size after 4."""
    start = 0
    while start < len(data):
        end = start + 4 + int.from_bytes(data[start + 2 : start + 4], "little")
        yield data[start:end]
        start = end


def datagrams() -> list[bytes]:
    """Conversations with a server of each version, a datagram every half second."""
    gathered = []
    for i, version in enumerate(VERSIONS):
        body = natnet.RigidBody(7, (0.5, 0.25, -1.0), (0.0, 0.0, 0.6, 0.8), True)
        parts = [
            pack_answer(natnet.ServerInfo("Motive", version, HZ, 1511)),
            pack_answer(natnet.Response(struct.pack("<f", 1000.0))),  # to the odd question
            pack_answer(natnet.Response(struct.pack("<i", 2))),  # to the even one
            pack_answer(natnet.ModelDef((("green", 7), ("hand", 12))), version),
            pack_answer(natnet.EchoResponse(ECHOED_NS, HZ * 1995 // 1000)),
        ]
        for k, number in enumerate((1, 2, 4)):
            exposed = HZ * (2490 + 500 * k) // 1000
            parts.append(pack_answer(natnet.NatNetFrame(number, (body,), 0, exposed), version))
        gathered.append(bytes([i]) + b"".join(parts))
        gathered += [bytes([i]) + part for part in parts[-2:]]
    return gathered


TARGETS = {
    "script": Target(script, files(SCRIPTS)),
    "natnet": Target(natnet_datagrams, datagrams),
}

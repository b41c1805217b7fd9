"""Good specs, packets and files for the fuzzer to start from, and how it spoils them."""

import random
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

from support.device_replies import packed_reply
from support.paths import ROOT
from tetractl_emulator.optitrack.natnet_server import pack_answer

from tetractl.experiment.plants import Calibration
from tetractl.experiment.yaml.core_yaml import dump
from tetractl.lab.actuators.m3pi import broadcast
from tetractl.lab.actuators.xbee import frames as xbee
from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cobs import Flag

VERSIONS = [
    natnet.Version(*v) for v in [(2, 6), (2, 7), (2, 9), (2, 11), (3, 0), (3, 1), (4, 1), (4, 3)]
]
MS = 1_000_000  # ns
ECHOED_NS = 1990 * MS  # when the ECHO that is answered was sent
HZ = 10_000_000  # of the server's clock


def calibrations() -> list[bytes]:
    wheel = {"gain_mm": 7.0, "dead_zone": 9, "invert": False}
    blue = {"name": "blue", "radius_mm": 41.5, "left": wheel, "right": wheel, "swap": True}
    found = Calibration(
        measured="2026-01-01T00:00:00Z",
        camera={"robots": [{"name": "blue", "heading_offset": 0.25}]},
        actuator={"robots": [blue]},
    )
    return [dump(found.model_dump(mode="json")).encode()]


def datagrams() -> list[bytes]:
    """Conversations with a server of each version, a datagram every half second."""
    found = []
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
        found.append(bytes([i]) + b"".join(parts))
        found += [bytes([i]) + part for part in parts[-2:]]
    return found


def serial_bytes() -> list[bytes]:
    command = broadcast.encode_command(broadcast.BroadcastCommand(7, Flag.RUN, ((64, -64), (1, 0))))
    reply = packed_reply(broadcast.Reply(1, 7, broadcast.Status(0), 5100, 20, 3))
    received = [
        b"\x81\x12\x34\x5e\1" + reply,
        xbee.at_response(1, b"BD", b"\x06"),
        b"\x89\1\0",
        xbee.BROADCAST + command,
    ]
    return [b"\x3f" + b"".join(map(xbee.encode, received)), b"\x20" + command + reply]


def logs() -> list[bytes]:
    return [path.read_bytes() for path in sorted((ROOT / "tests" / "golden").glob("*.mcap"))]


def files(folder: Path) -> Callable[[], list[bytes]]:
    return lambda: [path.read_bytes() for path in sorted(folder.glob("*.yaml"))]


NUMBERS = [0, 1, 127, 128, 255, 65_535, 2**31 - 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1]


def mutant(seeds: Sequence[bytes], rng: random.Random) -> bytes:
    """Return a seed with a few bytes changed, cut, repeated, or replaced by those of another."""
    data = bytearray(rng.choice(seeds))
    for _ in range(rng.randint(1, 4)):
        at, size = rng.randint(0, len(data)), rng.randint(1, 16)
        match rng.randrange(6):
            case 0 if at < len(data):
                data[at] = rng.randrange(256)
            case 1:
                del data[at : at + rng.choice([1, size, len(data)])]
            case 2:
                data[at:at] = rng.randbytes(size)
            case 3:
                data[at : at + size] = bytes(data[at : at + size]) * rng.choice([2, 3, 50])
            case 4:
                other = rng.choice(seeds)
                start = rng.randint(0, len(other))
                data[at:at] = other[start : start + rng.choice([size, 200])]
            case _:
                count = rng.choice(NUMBERS).to_bytes(8, "little")[: rng.choice([1, 2, 4, 8])]
                data[at : at + len(count)] = count
    return bytes(data)

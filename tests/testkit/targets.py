"""All parsers of bytes from outside, as functions that fail if a parser breaks its contract.

The tests fuzz these functions. benchmarks/fuzz.py also fuzzes those of the packages.
"""

import contextlib
import random
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

from testkit.device_replies import packed_reply
from testkit.paths import ROOT
from tetractl.core.errors import LogError, SpecError, UsageError, WireError
from tetractl.lab import cobs
from tetractl.lab.actuators.m3pi import broadcast
from tetractl.lab.actuators.wheel_commands import Reply, Status
from tetractl.lab.actuators.xbee import api_frames as xbee
from tetractl.lab.actuators.xbee.api_frames import (
    CONTENT_BYTES_MAX,
    Decoder,
    answered,
    encode,
    received,
)
from tetractl.lab.cobs import Flag
from tetractl.log.read.overview import overview
from tetractl.log.read.reader import read_result, read_trial
from tetractl.log.read.recover import recover
from tetractl.log.read.salvage import scan
from tetractl.spec.experiment import Experiment
from tetractl.spec.load import parse_spec
from tetractl.spec.plants import Calibration, apply_calibration, select_plant
from tetractl.spec.yaml.core_yaml import format_yaml

UNKNOWN = 2  # status of an answer: the module has no such parameter
LAB_SPEC = ROOT / "experiments" / "three_m3pi_lab.yaml"
LONGEST = 1 << 20


def encode_at_response(frame_id: int, command: bytes, value: bytes | None) -> bytes:
    """What an XBee module answers to a request; `value` is None for an unknown parameter."""
    status = UNKNOWN if value is None else xbee.STATUS_OK
    return xbee.RESPONSE.pack(xbee.AT_RESPONSE, frame_id, command, status) + (value or b"")


class Target(NamedTuple):
    """A parser: `run` takes any bytes, `seeds` are good ones to start from."""

    run: Callable[[bytes], None]
    seeds: Callable[[], Sequence[bytes]]


@contextlib.contextmanager
def only(*kinds: type[Exception], one_line: bool = True) -> Iterator[None]:
    """Let these exceptions pass, as long as a terminal can show their message."""
    try:
        yield
    except kinds as error:
        lines = str(error).split("\n")
        assert all(line and line.isprintable() for line in lines), str(error)
        assert len(lines) == 1 or not one_line, str(error)


@cache
def scratch() -> Path:
    return Path(tempfile.mkdtemp(prefix="tetractl-fuzz-"))


def written(data: bytes, name: str) -> Path:
    path = scratch() / name
    path.write_bytes(data)
    return path


def text(data: bytes) -> str:
    return data[:LONGEST].decode("utf-8", "replace")


def files(folder: Path) -> Callable[[], list[bytes]]:
    return lambda: [path.read_bytes() for path in sorted(folder.glob("*.yaml"))]


NUMBERS = [0, 1, 127, 128, 255, 65_535, 2**31 - 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1]


def mutant(seeds: Sequence[bytes], rng: random.Random) -> bytes:
    """Return a seed with a few bytes changed, cut, repeated, or replaced by those of another."""
    data = bytearray(rng.choice(seeds))
    for _ in range(rng.randint(1, 4)):
        offset = rng.randint(0, len(data))
        size = rng.randint(1, 16)
        match rng.randrange(6):
            case 0 if offset < len(data):
                data[offset] = rng.randrange(256)
            case 1:
                del data[offset : offset + rng.choice([1, size, len(data)])]
            case 2:
                data[offset:offset] = rng.randbytes(size)
            case 3:
                piece = bytes(data[offset : offset + size])
                data[offset : offset + size] = piece * rng.choice([2, 3, 50])
            case 4:
                donor = rng.choice(seeds)
                start = rng.randint(0, len(donor))
                data[offset:offset] = donor[start : start + rng.choice([size, 200])]
            case _:
                number = rng.choice(NUMBERS).to_bytes(8, "little")
                count = number[: rng.choice([1, 2, 4, 8])]
                data[offset : offset + len(count)] = count
    return bytes(data)


# specs, calibration files


def spec_text(text: str, *sets: str) -> None:
    with only(UsageError, one_line=False):
        assert isinstance(parse_spec(text, "s.yaml", sets).experiment, Experiment)


def spec(data: bytes) -> None:
    spec_text(text(data))


def calibration(data: bytes) -> None:
    with only(SpecError, one_line=False):
        experiment = apply_calibration(_lab(), text(data), "c.yaml")
        assert isinstance(experiment, Experiment)


@cache
def _lab():
    return select_plant(parse_spec(LAB_SPEC.read_text("utf-8"), "lab"), "lab").experiment


def calibrations() -> list[bytes]:
    wheel = {"gain_mm": 7.0, "dead_zone": 9, "invert": False}
    blue = {"name": "blue", "radius_mm": 41.5, "left": wheel, "right": wheel, "swap": True}
    values = Calibration(
        measured="2026-01-01T00:00:00Z",
        camera={"robots": [{"name": "blue", "heading_offset": 0.25}]},
        actuator={"robots": [blue]},
    )
    return [format_yaml(values.model_dump(mode="json")).encode()]


# serial bytes


def serial(data: bytes) -> None:
    """One byte for where reads are cut, then what comes from the port."""
    read_size = data[0] % 64 + 1 if data else 2
    stuff = data[1:]
    decoder = Decoder()
    splitter = cobs.FrameSplitter()
    for start in range(0, len(stuff), read_size):
        piece = stuff[start : start + read_size]
        for content in decoder.feed(piece):
            assert Decoder().feed(encode(content)) == [content]
            received(content)
            answered(content)
        assert len(decoder._raw_bytes) <= 2 * (CONTENT_BYTES_MAX + 3) + 1
        for frame in splitter.feed(piece):
            for decode in (broadcast.decode_reply, broadcast.decode_command):
                with only(WireError):
                    decode(frame)
        assert len(splitter._buffer) <= cobs.PAYLOAD_BYTES_MAX + 1
    assert decoder.dropped_bytes <= len(stuff)


def serial_bytes() -> list[bytes]:
    command = broadcast.encode_command(broadcast.BroadcastCommand(7, Flag.RUN, ((64, -64), (1, 0))))
    reply = packed_reply(Reply(1, 7, Status(0), 5100, 20, 3))
    received = [
        b"\x81\x12\x34\x5e\1" + reply,
        encode_at_response(1, b"BD", b"\x06"),
        b"\x89\1\0",
        xbee.BROADCAST + command,
    ]
    return [b"\x3f" + b"".join(map(xbee.encode, received)), b"\x20" + command + reply]


# logs


def log(data: bytes) -> None:
    """A file, whatever is in it."""
    path = written(data, "any.mcap")
    with only(LogError):
        contents = scan(path)
        assert all(line.isprintable() for line in (*contents.problems, *contents.lost))
    for read in (read_trial, read_result, overview):
        with only(LogError):
            read(path)
    with only(LogError):
        out = recover(path)
        Path(str(out.path)).unlink(missing_ok=True)


def logs() -> list[bytes]:
    return [path.read_bytes() for path in sorted((ROOT / "tests" / "golden").glob("*.mcap"))]


TARGETS = {
    "spec": Target(spec, files(ROOT / "experiments")),
    "calibration": Target(calibration, calibrations),
    "log": Target(log, logs),
    "serial": Target(serial, serial_bytes),
}

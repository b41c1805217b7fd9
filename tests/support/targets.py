"""Everything that reads bytes from outside, as functions of bytes that fail on a broken promise.

The same functions are fuzzed by hypothesis in the tests and by atheris in benchmarks/fuzz.py.
"""

import contextlib
import math
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from support import seeds
from support.paths import SCRIPTS
from support.seeds import MS, ROOT, VERSIONS
from tetractl_emulator.script import parse_script

from tetractl.core.errors import LogError, SpecError, UsageError, WireError
from tetractl.core.poses import CameraFrame
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.load import parse_spec
from tetractl.experiment.plants import calibrated, on_plant
from tetractl.lab import cobs
from tetractl.lab.actuators.m3pi import broadcast
from tetractl.lab.actuators.xbee.frames import CONTENT_MAX, Decoder, answered, encode, received
from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.pose import Placement, UpAxis
from tetractl.lab.cameras.optitrack.section import TrackedRobot
from tetractl.lab.cameras.optitrack.stream import AGE_MAX_NS, UNITS, UP_AXIS, Stream
from tetractl.lab.cameras.optitrack.wire import parse
from tetractl.log.read.overview import overview
from tetractl.log.read.reader import read_result, read_trial
from tetractl.log.read.recover import recover
from tetractl.log.read.salvage import scan

LAB_SPEC = ROOT / "experiments" / "three_m3pi_lab.yaml"
LONGEST = 1 << 20
SIDE = 128  # of a picture [px]


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


# specs, fault scripts, calibration files


def spec_text(text: str, *sets: str) -> None:
    with only(UsageError, one_line=False):
        assert isinstance(parse_spec(text, "s.yaml", sets).experiment, Experiment)


def spec(data: bytes) -> None:
    spec_text(text(data))


def script(data: bytes) -> None:
    with only(SpecError, one_line=False):
        found = parse_script(text(data), "s.yaml")
        assert all(math.isfinite(fault.at) for fault in found.faults)


def calibration(data: bytes) -> None:
    with only(SpecError, one_line=False):
        assert isinstance(calibrated(_lab(), text(data), "c.yaml"), Experiment)


@cache
def _lab():
    return on_plant(parse_spec(LAB_SPEC.read_text("utf-8"), "lab"), "lab").experiment


# NatNet


def sound(frame: CameraFrame) -> None:
    """No number reaches the controller or the log that they cannot hold."""
    for pose in (*frame.poses, *frame.strangers):
        assert pose is None or all(map(math.isfinite, (pose.x, pose.y, pose.heading)))
    assert 0 <= frame.received_ns - frame.sampled_ns <= AGE_MAX_NS


def stream(up: UpAxis | None = None) -> Stream:
    robots = (
        TrackedRobot(name="robot", body="green"),
        TrackedRobot(name="robot", body=12, heading_offset=0.5),
    )
    return Stream(robots, Placement(100.0, 200.0, 0.3, 1000.0), up=up, on_frame=sound)


def natnet_datagrams(data: bytes) -> None:
    """One byte for a version, then datagrams, cut where their headers say."""
    version, rest = VERSIONS[data[0] % len(VERSIONS)] if data else None, data[1:]
    for known in (version, None):
        with only(WireError):
            parse(rest, known)
    fed = stream()
    for question in (
        natnet.Connect(),
        natnet.Bare(natnet.MessageKind.REQUEST_MODELDEF),
        natnet.EchoRequest(seeds.ECHOED_NS),
    ):
        fed.asked(question)
    at = count = 0
    while at < len(rest):
        size = 4 + int.from_bytes(rest[at + 2 : at + 4], "little")
        fed.asked(natnet.NatNetRequest((UP_AXIS, UNITS)[count % 2]))
        fed.feed(rest[at : at + size], 500 * MS * count)
        at, count = at + size, count + 1
    seen = fed.counts
    assert seen.frames + seen.bad + seen.unasked <= count
    fed.missing()


# serial bytes


def serial(data: bytes) -> None:
    """One byte for where reads are cut, then what comes from the port."""
    cut, stuff = (data[:1] or b"\1")[0] % 64 + 1, data[1:]
    decoder, splitter = Decoder(), cobs.Splitter()
    for start, stop in pairwise([*range(0, len(stuff), cut), len(stuff)]):
        piece = stuff[start:stop]
        for content in decoder.feed(piece):
            assert Decoder().feed(encode(content)) == [content]
            received(content), answered(content)
        assert len(decoder._raw) <= 2 * (CONTENT_MAX + 3) + 1
        for frame in splitter.feed(piece):
            for decode in (broadcast.decode_reply, broadcast.decode_command):
                with only(WireError):
                    decode(frame)
        assert len(splitter._buffer) <= cobs.FRAME_MAX + 1
    assert decoder.dropped_bytes <= len(stuff)


# pictures


@cache
def _dish() -> tuple[list, list[bytes]]:
    """The pictures of a small film, and answers of a camera: that film, and absurd pictures."""
    from support.dish_films import film

    shown = list(film(seed=3, side=SIDE, cells=2, seconds=0.5).pictures())
    black, noise = (
        np.zeros((SIDE, SIDE), np.uint8),
        np.random.default_rng(1).integers(0, 2, (64, 64)),
    )
    blobs = np.kron(255 * noise, np.ones((2, 2))).astype(np.uint8)
    absurd = [shown[0], black, black + 255, blobs, shown[1], np.zeros((40, 9), np.uint8), shown[2]]
    return shown, [b"".join(part(coded(one, 90)) for one in some) for some in (shown, absurd)]


def pictures(data: bytes) -> None:
    """What a network camera answers, searched for cells."""
    from tetractl_microscope.cells.detect_cells import BLOBS
    from tetractl_microscope.cells.tracking import CellTracker

    tracker, parts = CellTracker(2.3, known=True), Multipart(BOUNDARY)
    tracker.finder.learn(_dish()[0])
    for k, body in enumerate(parts.feed(data)[:20]):
        grey = decoded(Picture(body, 0), (SIDE, SIDE))
        if grey is None:
            continue
        cells = tracker.see(grey, k / 30, lambda start, end: [(end - start, 1.0, 0.0)])
        assert len(cells) <= BLOBS
        for cell in cells:
            assert all(map(math.isfinite, (cell.x, cell.y, cell.heading, *cell.mean)))
            assert 0 <= cell.probability <= 1


# logs and recorded wires


def log(data: bytes) -> None:
    """A file, whatever is in it."""
    path = written(data, "any.mcap")
    with only(LogError):
        found = scan(path)
        assert all(line.isprintable() for line in (*found.problems, *found.lost))
    for read in (read_trial, read_result, overview):
        with only(LogError):
            read(path)
    with only(LogError):
        out = recover(path)
        Path(str(out.path)).unlink(missing_ok=True)


TARGETS = {
    "spec": Target(spec, seeds.files(ROOT / "experiments")),
    "script": Target(script, seeds.files(SCRIPTS)),
    "calibration": Target(calibration, seeds.calibrations),
    "log": Target(log, seeds.logs),
    "natnet": Target(natnet_datagrams, seeds.datagrams),
    "serial": Target(serial, seeds.serial_bytes),
}
if find_spec("cv2"):
    from tetractl_emulator.pictures.network_camera import BOUNDARY, coded, part
    from tetractl_microscope.pictures.feed import Picture
    from tetractl_microscope.pictures.multipart import Multipart
    from tetractl_microscope.pictures.source import decoded

    TARGETS["pictures"] = Target(pictures, lambda: _dish()[1])

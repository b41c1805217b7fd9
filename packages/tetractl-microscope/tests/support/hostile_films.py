"""Films made to hang, crash or fill the memory of who reads them."""

import os
import struct
import time
import traceback
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import tifffile
from support.cli import tetractl
from support.film_containers import folder
from support.needs_opencv import cv2

SECONDS_MAX = 60.0


def tiff(tags, data=b"", following=0):
    """A little-endian TIFF of one directory; tags are (code, type, count, value)."""
    first = 8 + len(data)
    entries = b"".join(struct.pack("<HHII", *tag) for tag in sorted(tags))
    return (
        b"II*\0" + struct.pack("<I", first) + data
        + struct.pack("<H", len(tags)) + entries + struct.pack("<I", following)
    )  # fmt: skip


def one_strip(width, height, packed, compression=8, following=0):
    size = (256, 257, 277, 278)
    short = 3
    tags = [(size[0], 4, 1, width), (size[1], 4, 1, height), (258, short, 1, 8)]
    tags += [(259, short, 1, compression), (262, short, 1, 1), (273, 4, 1, 8), (277, short, 1, 1)]
    return tiff([*tags, (278, 4, 1, height), (279, 4, 1, len(packed))], packed, following)


def zeros(megabytes):
    """So many MB of zeros, deflated."""
    packer = zlib.compressobj(9)
    packed = [packer.compress(bytes(2**20)) for _ in range(megabytes)]
    return b"".join(packed) + packer.flush()


def png(width, height, rows=0):
    """A PNG of 1 bit a pixel, black as far as it goes."""

    def chunk(kind, data):
        body = kind + data
        length = struct.pack(">I", len(data))
        check = struct.pack(">I", zlib.crc32(body))
        return length + body + check

    packed = zlib.compress(bytes(rows * (width // 8 + 1)), 9)
    head = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")
    )


def with_text(path, text):
    """A stack whose description is replaced."""
    tifffile.imwrite(path, small(), photometric="minisblack", description=text, metadata=None)


def small(count=4):
    return np.random.default_rng(count).integers(0, 256, (count, 64, 80), np.uint8)


def in_folder(name):
    def make(make_file):
        def made(path):
            path.mkdir()
            make_file(path / name)

        return made

    return make


def written(data):
    return lambda path: path.write_bytes(data() if callable(data) else data)


def pixels(attributes, inside="<TiffData/>"):
    return (
        '<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image ID="Image:0">'
        f'<Pixels ID="Pixels:0" DimensionOrder="XYCZT" Type="uint8" SizeX="80" SizeY="64" '
        f'{attributes}><Channel ID="Channel:0"/>{inside}</Pixels></Image></OME>'
    )


def values(pixels):
    return lambda path: tifffile.imwrite(path, pixels, photometric="minisblack")


def laughs():
    """Entities of entities, a thousand million at the end."""
    lines = "".join(
        f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' if k else '<!ENTITY l0 "lol">' for k in range(10)
    )
    return f"<?xml version='1.0'?><!DOCTYPE OME [{lines}]><OME>&l9;</OME>"


def fifo_named_by_tags(path):
    path.mkdir()
    os.mkfifo(path / "other.ome.tif")
    planes = (
        '<TiffData FirstT="0" PlaneCount="4"><UUID FileName="other.ome.tif">u:1</UUID></TiffData>'
    )
    with_text(path / "a.ome.tif", pixels('SizeC="1" SizeZ="1" SizeT="4"', planes))


def many_large(path):
    """A few kB a picture, each as large as a picture may be."""
    path.mkdir()
    data = png(4096, 4096, 4096)
    for k in range(60):
        (path / f"{k}.png").write_bytes(data)


def mjpeg(path):
    coded = cv2.imencode(".jpg", np.zeros((8000, 8000), np.uint8))[1].tobytes()
    path.write_bytes(coded * 3)


large_png = written(lambda: png(32768, 32768, 32768))
claiming_png = written(png(2**31 - 1, 2**31 - 1))
small_png = written(png(64, 64, 64))
INFINITE = np.where(np.eye(64) > 0, np.inf, -1e38).astype(np.float32)

BOMBS: dict[str, Callable[[Path], object]] = {
    "png of 1 Gpx in a folder": in_folder("1.png")(large_png),
    "png that only claims": in_folder("1.png")(claiming_png),
    "many large pictures": many_large,
    "bmp that claims": in_folder("1.bmp")(
        written(b"BM" + struct.pack("<IIIIiiHH24x", 54, 0, 54, 40, 65000, 65000, 1, 8))
    ),
    "pgm that claims": in_folder("1.pgm")(written(b"P5 100000 100000 255\n")),
    "folder named as a picture": in_folder("1.png")(lambda path: path.mkdir()),
    "fifo": os.mkfifo,
    "fifo in a folder": in_folder("1.png")(os.mkfifo),
    "endless device": in_folder("1.png")(lambda path: path.symlink_to("/dev/zero")),
    "name with a superscript": in_folder("²1.png")(small_png),
    "fifo named by tags": fifo_named_by_tags,
    "deflate bomb": written(lambda: one_strip(64, 64, zeros(400))),
    "deflate bomb of many pages": written(lambda: one_strip(64, 64, zeros(400), following=8)),
    "tiff of 4 Gpx": written(one_strip(65535, 65535, bytes(100))),
    "pages in a loop": written(one_strip(64, 64, bytes(4096), 1, following=8 + 4096)),
    "tags that claim": written(
        tiff([(270, 2, 2**32 - 1, 8), (256, 4, 2**31, 8), (273, 16, 2**30, 8)])
    ),
    "no tags": written(tiff([])),
    "strips without end": written(
        tiff([(256, 4, 1, 4096), (257, 4, 1, 4096), (258, 3, 1, 8), (259, 3, 1, 8), (278, 4, 1, 1),
              (262, 3, 1, 1), (277, 3, 1, 1), (273, 4, 4096, 8), (279, 4, 4096, 8)], bytes(20000))
    ),
    "ome of 10^9 pictures": lambda path: with_text(
        path, pixels('SizeC="1" SizeZ="1" SizeT="1000000000"')
    ),
    "ome of 10^27 planes": lambda path: with_text(
        path, pixels('SizeC="1000000000" SizeZ="1000000000" SizeT="1000000000"')
    ),
    "ome of planes without end": lambda path: with_text(
        path, pixels('SizeC="1" SizeZ="1" SizeT="4"', '<TiffData PlaneCount="2000000000"/>')
    ),
    "ome of a modulo": lambda path: with_text(path, pixels('SizeC="-1" SizeZ="0" SizeT="4"')),
    "entities of entities": lambda path: with_text(path, laughs()),
    "deep xml": lambda path: with_text(path, "<OME>" + "<a>" * 100_000),
    "imagej of 10^9 pictures": lambda path: with_text(
        path, "ImageJ=1.53c\nimages=1000000000\nslices=1000000000\nfinterval=0.1\nunit=um\n"
    ),
    "imagej of no interval": lambda path: with_text(
        path, "ImageJ=1.53c\nimages=4\nframes=4\nfinterval=-nan\nunit=um\nfps=0\n"
    ),
    "mjpeg of 64 Mpx": mjpeg,
    "nd2 of nothing": written(b"\xda\xce\xbe\n" + bytes(10_000)),
    "times without end": lambda path: (
        folder(path, small()), (path / "times.csv").write_text("time_s\n" + "1e999\n" * 4)
    ),
    "no values": values(np.full((6, 64, 64), np.nan, np.float32)),
    "infinite values": values(INFINITE),
    "complex values": values(np.ones((6, 64, 64), np.complex64)),
}  # fmt: skip


def outcome(folder: Path, path: Path) -> tuple[str, str, float]:
    """Follow a film; return how it ended, what was said, and the time [s]."""
    began = time.perf_counter()
    try:
        words = ("--scale", "2.3", "--rate", "30")
        done = tetractl(folder, "track", path.name, *words)
    except Exception:
        return "traceback", traceback.format_exc(), time.perf_counter() - began
    said = done.stderr.strip()
    seconds = time.perf_counter() - began
    lines = [line for line in said.splitlines() if not line.startswith("  ")]
    if done.returncode not in (0, 1, 2) or (done.returncode and not lines):
        return f"exit {done.returncode}", said, seconds
    return "slow" if seconds > SECONDS_MAX else f"ended with {done.returncode}", said, seconds

"""The pictures of a film in order, as grey levels; a process of their own, `decode`, reads them."""

import json
import math
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING, Any
from weakref import finalize

from tetractl.core.errors import AbortError, UsageError
from tetractl.core.table.table_files import read_csv

if TYPE_CHECKING:
    from tetractl.core.poses import Grey

RATES_HZ = (0.1, 2000.0)
SCALES_UM = (0.05, 100.0)
DIFFERENT = 0.01  # relative difference of a given value from the film's own that is said
KEPT_MAX = 2**30  # largest file in which a film's pictures are kept [B]
EVEN = 1e-3  # deviation from an even rate that is rounding [pictures]
TIMES_FILE, TIME = "times.csv", "time_s"


@dataclass(slots=True, weakref_slot=True)
class FilmPictures:
    """The pictures at a path, which can be iterated over repeatedly. `rate_hz` is the rate given,
    or the film's own; so is the scale `um_px`, None if it is unknown.

    `times` are the pictures' times [s], None if they follow from the rate. The grey levels are
    (value - low) / step with `levels`. `remarks` are lines on the film's tags. `damaged` is the
    number of pictures in the last iteration that could not be read, or differed in size from the
    first one read.
    """

    path: Path
    rate_hz: float
    um_px: float | None = None
    times: Sequence[float] | None = None
    levels: tuple[float, float] = (0.0, 1.0)
    remarks: list[str] = field(default_factory=list)
    damaged: int = 0
    _kept: tuple[int, list[int], tuple[int, int]] | None = None  # file, numbers and shape

    def __iter__(self) -> Iterator[tuple[int, "Grey"]]:
        """Yield number and grey levels (height, width) of each picture that can be read.

        A film is decoded once: its pictures are kept in a file, unless they exceed KEPT_MAX.
        """
        import numpy as np

        if self._kept is not None:
            file, numbers, shape = self._kept
            size = shape[0] * shape[1]
            for k, number in enumerate(numbers):
                pixels = os.pread(file, size, k * size)
                yield number, np.frombuffer(pixels, np.uint8).reshape(shape)
            return
        self.damaged, shape, number, numbers, room = 0, None, 0, list[int](), KEPT_MAX
        with (
            _decoder(self.path, *self.levels) as (_, stream),
            TemporaryFile(buffering=0) as kept,
        ):
            while head := stream.read(8):
                sides = int.from_bytes(head[:4], "little"), int.from_bytes(head[4:], "little")
                pixels = stream.read(sides[0] * sides[1])
                if not sides[0] or sides != (shape or sides) or len(pixels) < sides[0] * sides[1]:
                    self.damaged += 1
                else:
                    shape, room = sides, room - len(pixels)
                    numbers.append(number)
                    if room >= 0:
                        with suppress(OSError):  # the disk may be full
                            kept.write(pixels)
                    yield number, np.frombuffer(pixels, np.uint8).reshape(shape)
                number += 1
            size = os.fstat(kept.fileno()).st_size
            if shape is not None and size == len(numbers) * shape[0] * shape[1]:
                self._kept = os.dup(kept.fileno()), numbers, shape
                finalize(self, os.close, self._kept[0])

    def seconds(self, number: int) -> float:
        """Return the time of a picture [s]."""
        return number / self.rate_hz if self.times is None else self.times[number]


def open_film(path: Path, rate_hz: float | None = None, um_px: float | None = None) -> FilmPictures:
    """Return the pictures of a film or a folder, with the rate and the scale given or else its own.

    UsageError if there are no pictures, or no rate.
    """
    opencv()
    if not path.exists():
        raise UsageError(f"{path}: no such file or folder")
    if not path.is_dir() and not path.is_file():
        raise UsageError(f"{path}: is not a regular file")
    with _decoder(path) as (own, _):
        pass
    times, remarks = own["times"], own["remarks"]
    if (path / TIMES_FILE).exists():
        times = _times(path / TIMES_FILE, own["count"])
    rate = own["rate_hz"] if times is None else (len(times) - 1) / (times[-1] - times[0])
    rate = _preferred("--rate", rate_hz, rate, RATES_HZ, remarks)
    scale = _preferred("--scale", um_px, own["um_px"], SCALES_UM, remarks)
    if rate is None:
        hint = "give --rate HZ" + f", or {TIMES_FILE} in the folder" * path.is_dir()
        raise UsageError(f"{path}: states no rate", hint)
    times = None if rate_hz is not None else times
    if times is not None and all(abs(t * rate - k) < EVEN for k, t in enumerate(times)):
        times = None
    return FilmPictures(path, rate, scale, times, own["levels"], remarks)


def opencv():
    """Import OpenCV, silence its messages, and return it; AbortError if it is not installed."""
    # FFmpeg's messages are not errors of tetractl
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    try:
        import cv2
    except ModuleNotFoundError as error:
        raise AbortError(
            "films are read by OpenCV, which is not installed", "pip install 'tetractl[vision]'"
        ) from error
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    return cv2


@contextmanager
def _decoder(path: Path, *levels: float) -> Iterator[tuple[dict[str, Any], IO[bytes]]]:
    """Start a process that decodes a film; yield what the film states, and the stream of its
    pictures. TetractlError if the film cannot be decoded.
    """
    process = subprocess.Popen(
        # without -P, a file such as cv2.py in the present folder would be run
        [sys.executable, "-P", "-m", "tetractl.film.decode", str(path), *map(repr, levels)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},  # each thread would take memory
    )
    died = UsageError(f"{path}: cannot be decoded in 20 s and 320 MB", "is the film damaged?")
    assert process.stdout is not None
    try:
        said = json.loads(process.stdout.readline() or "null")
        if said is None:
            raise died
        if "error" in said:
            kind = UsageError if said["exit"] == UsageError.exit else AbortError
            raise kind(said["error"], said["hint"])
        yield said, process.stdout
        if process.wait():
            raise died
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def _preferred(
    option: str, given: float | None, own: float | None, span: tuple[float, float], said: list[str]
) -> float | None:
    """Return the value given, or else the film's own if it is possible; say if they differ."""
    if own is None or not span[0] <= own <= span[1]:
        return given
    if given is not None and abs(given / own - 1) > DIFFERENT:
        said.append(f"{option} {given:g} is used; the film states {own:.4g}")
    return float(f"{own:.9g}") if given is None else given  # 30, not 29.999999999999996


def _times(path: Path, count: int) -> list[float]:
    """Return the times of a folder's pictures [s] from its file of times."""
    times = [-math.inf]
    for line, row in enumerate(read_csv(path), 2):
        try:
            times.append(float(row[TIME]))
        except (KeyError, ValueError):
            raise UsageError(f"{path}, line {line}: has no number in column {TIME}") from None
        if not times[-2] < times[-1] < math.inf:
            raise UsageError(f"{path}, line {line}: the time is not after that before")
    if len(times) - 1 != count or count < 2:
        raise UsageError(f"{path}: has {len(times) - 1} times for {count} pictures")
    return times[1:]

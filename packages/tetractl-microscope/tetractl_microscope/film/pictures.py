"""The pictures of a film in order, as grey levels; a process of their own, `decode`, reads them."""

import itertools
import math
import os
import pickle
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any
from weakref import finalize

import numpy as np

from tetractl.core.errors import UsageError
from tetractl.core.poses import Grey
from tetractl.tools.children import Child, python
from tetractl_microscope.film.film_source import DIFFERENT
from tetractl_microscope.film.picture_names import TIMES_FILE
from tetractl_microscope.film.picture_times import PictureTimes, mean_rate_hz
from tetractl_microscope.number_columns import read_times

RATES_HZ = (0.1, 2000.0)
SCALES_UM = (0.05, 100.0)
KEPT_MAX = 2**30  # largest file in which a film's pictures are kept [B]
ONE_PICTURE = "is one picture, and no film"
DAMAGED = -1  # place of a picture that is not in the file of those kept
ONE_PICTURE_HINT = "give the film, or the folder of its pictures"


class PictureStore:
    """Keeps the first pictures of a film, all of one size, in a temporary file: up to KEPT_MAX."""

    def __init__(self) -> None:
        self._file: IO[bytes] = TemporaryFile(buffering=0)  # noqa: SIM115 - closed with the store
        self._places: list[int] = []  # of the pictures in the file, or DAMAGED
        self._shape: tuple[int, ...] = (0, 0)
        finalize(self, self._file.close)

    def __len__(self) -> int:
        """The number of pictures, damaged ones included."""
        return len(self._places)

    @property
    def damaged(self) -> int:
        """The number of damaged pictures."""
        return self._places.count(DAMAGED)

    def __iter__(self) -> Iterator[tuple[int, Grey]]:
        """Yield number and grey levels of each picture that is not damaged."""
        for number, place in enumerate(self._places):
            if place != DAMAGED:
                pixels = os.pread(self._file.fileno(), math.prod(self._shape), place)
                yield number, np.frombuffer(pixels, np.uint8).reshape(self._shape)

    def add(self, picture: Grey | None) -> None:
        """Keep the next picture, None if it is damaged, as long as there is room."""
        if picture is None:
            self._places.append(DAMAGED)
            return
        place = self._file.tell()
        self._shape = picture.shape
        if place + picture.size <= KEPT_MAX:
            with suppress(OSError):  # the disk may be full
                if self._file.write(picture.data) == picture.size:
                    self._places.append(place)


@dataclass(slots=True)
class FilmPictures:
    """The pictures at a path, which can be iterated over repeatedly, and their scale `um_px`: the
    one given, or the film's own, None if it is unknown.

    `timing` gives the times of the pictures; `own_timing` are those that the film states, which a
    given rate replaces. `remarks` are lines on the film's tags. `damaged` is the number of pictures
    so far that could not be read, or differed in size from most.
    """

    path: Path
    timing: PictureTimes
    own_timing: PictureTimes | None
    um_px: float | None
    remarks: list[str]
    _stream: Iterator[Any]  # pictures that are not decoded yet
    damaged: int = 0
    _next: int = 0  # number of the picture that the stream gives next
    _store: PictureStore = field(default_factory=PictureStore)

    def __iter__(self) -> Iterator[tuple[int, Grey]]:
        """Yield number and grey levels (height, width) of each picture that can be read.

        A film is decoded once: its pictures are kept in a file, except those beyond KEPT_MAX.
        """
        yield from self._store
        if self._next > len(self._store):  # those beyond KEPT_MAX are decoded again
            self._next = len(self._store)
            self.damaged = self._store.damaged
            self._stream = itertools.islice(_decoded(self.path), self._next + 1, None)
        for number, (picture, clock_s) in enumerate(self._stream, self._next):
            self._next = number + 1
            if self.own_timing is not None and clock_s is not None:
                self.own_timing.note(number, clock_s)
            if number == len(self._store):
                self._store.add(picture)
            if picture is None:
                self.damaged += 1
            else:
                yield number, picture

    @property
    def rate_hz(self) -> float:
        """The mean rate of the pictures that were read so far [Hz]."""
        return self.timing.rate_hz

    @property
    def times(self) -> list[float] | None:
        """The times of the pictures that were read so far [s]; None if they are at `rate_hz`."""
        return None if self.timing.even else self.timing.stated

    def seconds(self, number: int) -> float:
        """Return the time of a picture [s]."""
        return self.timing.seconds(number)

    def time_line(self) -> str | None:
        """Return a line on the times of the pictures that were read, if they are uneven."""
        timing = self.own_timing
        uneven = None if timing is None else timing.uneven_line()
        if timing is None or uneven is None:
            return None
        if timing is self.timing:
            return f"times are those of {timing.source}: {uneven}"
        return f"warning: --rate replaces the times of {timing.source}: {uneven}"


def open_film(path: Path, rate_hz: float | None = None, um_px: float | None = None) -> FilmPictures:
    """Return the pictures of a film or a folder, with the rate and the scale given or else its own.

    UsageError if there are no pictures, one only, or no rate.
    """
    if not path.is_dir() and not path.is_file():
        said = "is not a regular file" if path.exists() else "no such file or folder"
        raise UsageError(f"{path}: {said}")
    stream = _decoded(path)
    stated_by_film = next(stream)
    if stated_by_film["count"] == 1:
        raise UsageError(f"{path}: {ONE_PICTURE}", ONE_PICTURE_HINT)
    remarks = stated_by_film["remarks"]
    stated = stated_by_film["times"]
    source = "the film"
    if (path / TIMES_FILE).exists():
        stated = _times(path / TIMES_FILE, stated_by_film["count"])
        source = TIMES_FILE
    own_hz = stated_by_film["rate_hz"] if stated is None else mean_rate_hz(stated)
    rate = _preferred("--rate", rate_hz, own_hz, RATES_HZ, remarks)
    scale = _preferred("--scale", um_px, stated_by_film["um_px"], SCALES_UM, remarks)
    if rate is None:
        hint = "give --rate HZ" + f", or {TIMES_FILE} in the folder" * path.is_dir()
        raise UsageError("; ".join([f"{path}: states no rate", *remarks]), hint)
    own_timing = None
    if stated is not None:
        own_timing = PictureTimes(rate if rate_hz is None else own_hz, stated, source)
        if own_timing.even:  # but for rounding
            own_timing = PictureTimes(own_timing.nominal_hz)
    elif stated_by_film["clock_s"] is not None and _possible(own_hz, RATES_HZ):
        own_timing = PictureTimes(own_hz if rate_hz else rate, [], source)
    timing = PictureTimes(rate) if rate_hz or own_timing is None else own_timing
    if stated is None and stated_by_film["places"] is not None:
        by_number_s = [place / rate for place in stated_by_film["places"]]
        timing = own_timing = PictureTimes(rate, by_number_s, "the numbers in their names")
    return FilmPictures(path, timing, own_timing, scale, remarks, stream)


def _decoded(path: Path) -> Iterator[Any]:
    """Decode a film in another process: yield what it states, then its pictures (height, width), or
    None for one that is damaged or not as large as the first. TetractlError if it is no film.
    """
    # each thread of its libraries would take memory
    limits = {"OPENBLAS_NUM_THREADS": "1"}
    process = Child(python("tetractl_microscope.film.decode", str(path)), environment=limits)
    stream = process.stdout
    try:
        said, error = pickle.load(stream)
        if error is not None:
            raise error
        yield said
        while True:
            yield pickle.load(stream)
    except (EOFError, pickle.UnpicklingError):  # the process has ended
        if process.wait():
            said = f"{path}: cannot be decoded in 20 s of the processor and 320 MB"
            raise UsageError(said, "is the film damaged?") from None
    finally:
        process.kill()
        stream.close()


def _preferred(
    option: str,
    wanted: float | None,
    stated: float | None,
    span: tuple[float, float],
    said: list[str],
) -> float | None:
    """Return the value of an option, or else what the film states if it is possible; say if they
    differ.
    """
    if stated is None or not 0 < stated < math.inf:
        return wanted
    if not _possible(stated, span):
        least, most = span
        said.append(
            f"what it states for {option}, {stated:.4g}, is not used: not in {least:g} to {most:g}"
        )
        return wanted
    if wanted is not None and abs(wanted / stated - 1) > DIFFERENT:
        said.append(f"{option} {wanted:g} is used; the film states {stated:.4g}")
    return float(f"{stated:.9g}") if wanted is None else wanted  # 30, not 29.999999999999996


def _possible(value: float, span: tuple[float, float]) -> bool:
    return span[0] <= value <= span[1]


def _times(path: Path, count: int) -> list[float]:
    """Return the times of a folder's pictures [s] from its file of times."""
    times = read_times(path).tolist()
    for line, (before, after) in enumerate(itertools.pairwise(times), 3):
        if after <= before:
            raise UsageError(f"{path}, line {line}: the time is not after that before")
    if len(times) != count or count < 2:
        raise UsageError(f"{path}: has {len(times)} times for {count} pictures")
    return times

"""Films that are open: those that OpenCV reads, and Nikon's ND2; their grey levels.

`nd2` is the library on which bioio's reader of ND2 is built.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tetractl.core.errors import UsageError
from tetractl.core.poses import Grey
from tetractl.tools.table.quantities import SECONDS, factor
from tetractl_microscope.film.picture_times import increasing, mean_rate_hz

PIXELS_MAX = 4096 * 4096  # largest picture that is read [px]
SAMPLED = 25  # number of pictures that give a film's range of grey levels, and its size
THIN = 4  # step between the pixels of these that are examined
SPREAD_LEAST = 32  # least span of a film's grey levels after conversion, of 256
SPREAD = 200  # span of the grey levels of a film that is stretched
SHARE = 0.1  # percentage of the darkest and of the brightest pixels that stretching may cut off
JPEG = b"\xff\xd8\xff"  # first bytes; a bare sequence of JPEG pictures states no rate
AXES = {"C": "channels", "Z": "slices", "P": "positions", "R": "positions"}
LENGTHS_UM = {"nm": 1e-3, "um": 1.0, "\\u00b5m": 1.0, "mm": 1e3, "cm": 1e4, "m": 1e6}
TIMES_S = {
    **SECONDS,
    **dict.fromkeys(("h", "hr", "hour", "hours"), 3600.0),
    **dict.fromkeys(("d", "day", "days"), 86400.0),
}
HEADER_B = 64  # fewer bytes than a picture's header and its entry in the index take, in ND2
DIFFERENT = 0.01  # relative difference of two statements of a value that is said
Raw = np.ndarray | None
"""A picture (height, width) of any type, or (height, width, 3) in colour; None if it is damaged."""


@dataclass(slots=True)
class FilmSource:
    """An open film, and what it states: scale [um/px], rate [Hz], times of its pictures [s] from
    the first one, their number; None for what it does not state. `places` are the pictures' places
    in a series some of which are missing. `remarks` are lines to print.

    `read` returns a picture by its index. A film without `count` has 8 bits, and ends where `read`
    gives None; `clock_s` is the time that its container gives the picture read last [s].
    """

    read: Callable[[int], Raw]
    count: int | None = None
    um_px: float | None = None
    rate_hz: float | None = None
    times: list[float] | None = None
    places: list[int] | None = None
    remarks: list[str] = field(default_factory=list)
    clock_s: float | None = None

    def pictures(self) -> Iterator[Raw]:
        """Yield the pictures in order."""
        for index in itertools.count() if self.count is None else range(self.count):
            picture = self._picture(index)
            if picture is self.count is None:
                return
            yield picture

    def sample(self) -> Iterator[Raw]:
        """Yield SAMPLED pictures that are spread over the film; none of a film of 8 bits."""
        end = self.count or 0
        yield from map(self._picture, range(0, end, max(1, end // SAMPLED)))

    def _picture(self, index: int) -> Raw:
        with suppress(Exception):  # the libraries do not document what they raise
            picture = self.read(index)
            if picture is not None and picture.dtype.kind in "buif":
                return picture if picture.size and picture.ndim in (2, 3) else None
        return None

    def over_time(self, axes: str, shape: Sequence[int]) -> list[int]:
        """Return the indices of the pictures of a film among planes with these axes and lengths.

        Time is axis T or, if that is missing or has one plane, the longest: films are written as
        slices, too. The first of each other axis is taken, which `remarks` then say.
        """
        along = axes.find("T")
        if along < 0 or shape[along] == 1:
            along = int(np.argmax([*shape, 0]))
        for i, (axis, length) in enumerate(zip(axes, shape, strict=True)):
            if i != along and length > 1:
                self.remarks.append(f"the first of {length} {AXES.get(axis, 'planes')} is read")
        self.count = shape[along] if axes else 1
        return [math.prod(shape[along + 1 :]) * i for i in range(self.count)]

    def add_times(self, times: Sequence[float | None]) -> None:
        """Add the times of the pictures [s], which replace the rate, as far as they are stated."""
        self.times, lines = increasing(times)
        self.remarks += lines
        planned_hz = self.rate_hz
        if self.times is None:
            if lines and planned_hz:
                self.remarks.append(f"the planned rate, {planned_hz:.4g} Hz, is used")
            return
        self.rate_hz = mean_rate_hz(self.times)
        if planned_hz and abs(planned_hz / self.rate_hz - 1) > DIFFERENT:
            self.remarks.append(
                f"the film was planned at {planned_hz:.4g} Hz, but its pictures were taken at "
                f"{self.rate_hz:.4g} Hz, by their times"
            )

    def seconds(self, value: Any, unit: Any) -> float | None:
        """Return the value of a tag in s; None if it is missing, or its unit unknown, which
        `remarks` then say.
        """
        if value is None:
            return None
        second = factor(str(unit), TIMES_S)
        if second is None:
            said = f"warning: its unit of time {str(unit)[:20]!r} is unknown, and not used"
            if said not in self.remarks:
                self.remarks.append(said)
            return None
        return _number(value, second)


def micrometres(value: Any, unit: Any) -> float | None:
    """Return the value of a tag in um; None if it is missing, or its unit unknown."""
    return _number(value, factor(str(unit), LENGTHS_UM))


def _number(value: Any, size: float | None) -> float | None:
    """Return the value of a tag times the size of its unit; None if it is no number."""
    try:
        return None if size is None else float(value) * size
    except (TypeError, ValueError):
        return None


def thinned(picture: Raw) -> tuple[tuple[int, int], Raw]:
    """Return height and width of a picture, and every THIN-th of its pixels in both directions."""
    if picture is None:
        return (0, 0), None
    return picture.shape[:2], picture[::THIN, ::THIN].copy()


def grey_scale(sample: Iterable[Raw]) -> tuple[float, float]:
    """Return the grey levels (low, step) of a film, from pictures spread over it, which may be
    thinned: a value becomes (value - low) / step.

    The 8 bits are the uppermost of those in use, as of a camera: 12 bits in a file of 16 are
    divided by 16, and floats up to 1 multiplied by 255. If the film then had too few grey levels to
    tell cells from noise, its own range, without the outermost pixels, is stretched instead.
    """
    deep = (picture for picture in sample if picture is not None and picture.dtype != np.uint8)
    values = np.concatenate([[], *(picture.astype(np.float32).ravel() for picture in deep)])
    values = values[np.isfinite(values)]
    if not values.size:
        return 0.0, 1.0
    least = float(values.min())
    most = float(values.max())
    unit = least >= 0 and most <= 1
    bits = math.ceil(math.log2(max(most, 1) + 1))
    step = 1 / 255 if unit else 2.0 ** max(0, bits - 8)
    low, high = np.percentile(values, (SHARE, 100 - SHARE)).tolist()
    if high > low and (least < 0 or high - low < SPREAD_LEAST * step):
        step = (high - low) / SPREAD
        return low - (256 - SPREAD) / 2 * step, step
    return -step / 2 if unit else 0.0, step


def grey_levels(picture: np.ndarray, low: float, step: float) -> Grey:
    """Return a picture with 8 bits; one that has 8 bits already keeps its grey levels."""
    if picture.ndim == 3:
        picture = picture[..., :3].mean(axis=-1).astype(picture.dtype)
    if picture.dtype == np.uint8:
        return picture
    levels = (picture.astype(np.float32) - low) / step
    return np.clip(np.nan_to_num(levels, copy=False), 0, 255).astype(np.uint8)


def video_film(path: Path) -> FilmSource:
    """Open a film that OpenCV reads, which converts it to 8 bits."""
    # by one thread: each has pictures of its own in memory
    capture = cv2.VideoCapture(str(path), cv2.CAP_ANY, [cv2.CAP_PROP_N_THREADS, 1])
    if not capture.isOpened():  # by a reader whose number of threads cannot be set
        capture = cv2.VideoCapture(str(path))
    with path.open("rb") as file:
        is_one_picture = file.read(len(JPEG)) == JPEG
    own_hz = None if is_one_picture else float(capture.get(cv2.CAP_PROP_FPS))

    def read(_: int) -> Raw:
        was_read, pixels = capture.read()
        if not was_read:
            return None
        if own_hz is not None:
            source.clock_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        return cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY) if pixels.ndim == 3 else pixels

    source = FilmSource(read, rate_hz=own_hz)
    return source


def nd2_film(path: Path) -> FilmSource:
    """Open an ND2 file, whose frames have the times that the microscope noted."""
    file: Any = import_module("nd2").ND2File(path)
    sizes = file.sizes

    def read(index: int) -> np.ndarray:
        pixels = np.asarray(file.read_frame(chosen[index]))
        # samples of a colour camera come last, channels first
        return pixels if "S" in sizes else pixels.reshape(-1, sizes["Y"], sizes["X"])[0]

    source = FilmSource(read, um_px=file.voxel_size().x)
    loops = [(axis, length) for axis, length in sizes.items() if axis not in "CYXS"]
    chosen = source.over_time("".join(a for a, _ in loops), [length for _, length in loops])
    size_b = path.stat().st_size
    if len(chosen) * HEADER_B > size_b:  # the library makes up pictures that are missing
        said = f"{path}: cannot have {len(chosen)} pictures in {size_b} bytes"
        raise UsageError(said, "is the film damaged?")
    if sizes.get("C", 1) > 1:
        source.remarks.append(f"the first of {sizes['C']} channels is read")
    if loops:
        noted = (file.frame_metadata(frame).channels[0].time for frame in chosen)
        source.add_times([time.relativeTimeMs / 1000 for time in noted])
    return source

"""Reads the pictures of a film, a folder or an MJPEG file in order, as grey levels."""

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tetractl.core.errors import AbortError, UsageError

if TYPE_CHECKING:
    import numpy as np

    from tetractl.core.poses import Grey

PICTURES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm"})
SIDE_MAX = 8192  # longest side of a picture [px]
USUAL_HZ = 30.0
_DIGITS = re.compile(r"(\d+)")


@dataclass(slots=True)
class FilmPictures:
    """The pictures at a path, which can be iterated over repeatedly. `rate_hz` is the rate given,
    or the film's own.

    `damaged` is the number of pictures in the last iteration that could not be read, or differed in
    size from the first one read.
    """

    path: Path
    rate_hz: float
    damaged: int = 0

    def __iter__(self) -> Iterator[tuple[int, "Grey"]]:
        """Yield number and grey levels (height, width) of each picture that can be read."""
        self.damaged, size = 0, None
        source = _folder(self.path) if self.path.is_dir() else _video(self.path)
        for number, picture in enumerate(source):
            fits = picture is not None and max(picture.shape) <= SIDE_MAX
            if picture is None or not fits or picture.shape != (size or picture.shape):
                self.damaged += 1
                continue
            size = picture.shape
            yield number, picture


def open_film(path: Path, rate_hz: float | None = None) -> FilmPictures:
    """Return the pictures of a film or a folder; UsageError if there are none."""
    cv2 = opencv()
    if path.is_dir():
        if not _names(path):
            raise UsageError(
                f"{path}: contains no pictures",
                f"names of pictures end in {', '.join(sorted(PICTURES))}",
            )
        return FilmPictures(path, rate_hz or USUAL_HZ)
    if not path.exists():
        raise UsageError(f"{path}: no such file or folder")
    capture = cv2.VideoCapture(str(path)) if path.is_file() else None
    try:
        if capture is None or not capture.isOpened() or not capture.grab():
            raise UsageError(
                f"{path}: OpenCV cannot read this film",
                "convert it to AVI or MP4, or give a folder of pictures",
            )
        own = float(capture.get(cv2.CAP_PROP_FPS))
    finally:
        if capture is not None:
            capture.release()
    return FilmPictures(path, rate_hz or (own if 0.5 <= own <= 2000 else USUAL_HZ))


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


def _names(folder: Path) -> list[Path]:
    """Return the pictures' paths in a folder, ordered by the numbers in their names."""

    def order(path: Path) -> list[tuple[int, int, str]]:
        parts = _DIGITS.split(path.name)
        return [(1, int(p), "") if p.isdecimal() else (0, 0, p) for p in parts]

    found = (path for path in folder.iterdir() if path.suffix.lower() in PICTURES)
    return sorted(found, key=order)


def _folder(folder: Path) -> Iterator["Grey | None"]:
    cv2 = opencv()
    for path in _names(folder):
        try:
            yield _grey(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
        except cv2.error:  # the picture's header states a size that OpenCV refuses
            yield None


def _video(path: Path) -> Iterator["Grey | None"]:
    cv2 = opencv()
    capture = cv2.VideoCapture(str(path))
    try:
        while True:
            read, pixels = capture.read()
            if not read:
                return
            yield _grey(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY) if pixels.ndim == 3 else pixels)
    finally:
        capture.release()


def _grey(pixels: "np.ndarray | None") -> "Grey | None":
    import numpy as np

    return None if pixels is None or pixels.ndim != 2 else pixels.astype(np.uint8, copy=False)

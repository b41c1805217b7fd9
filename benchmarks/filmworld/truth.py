"""A synthetic film on disk: film.avi, field.csv for `tetractl track --field`, and its truth."""

import os
import shutil
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

LEVELS = ("easy", "normal", "hard")
VIEW_UM = 30.0  # a cell whose middle is nearer to the picture's edge need not be found


@dataclass(frozen=True, slots=True)
class FilmTruth:
    """The truth of K pictures with M individuals, at the middle of each exposure.

    `x`, `y` [um], with y up, are in the picture's coordinates, also after a knock; `heading` [rad]
    is that of the helix, `speed` [um/s] along it (all (K, M), NaN where an individual is not
    there). `a` [rad/s] is 0 for a stranger, NaN if it changes; `parent` is the index of the
    individual that divided, else -1; `resting` (K, M). `turns` (T, 2) are times [s] and directions
    [rad] of the field, `recorded` (T,) the times that the file states.
    """

    times: np.ndarray
    x: np.ndarray
    y: np.ndarray
    heading: np.ndarray
    speed: np.ndarray
    resting: np.ndarray
    a: np.ndarray
    parent: np.ndarray
    turns: np.ndarray
    recorded: np.ndarray
    um_px: float
    side_px: int

    @property
    def view(self) -> np.ndarray:
        """Whether each individual is wholly in the picture (K, M)."""
        span = self.side_px * self.um_px
        with np.errstate(invalid="ignore"):
            low = np.minimum(self.x, self.y) > VIEW_UM
            return low & (np.maximum(self.x, self.y) < span - VIEW_UM)

    def only(self, is_there: np.ndarray) -> "FilmTruth":
        """Return the truth of individuals that are there, or not, in each picture (K, M)."""
        states = {name: getattr(self, name) for name in ("x", "y", "heading", "speed")}
        hidden = {name: np.where(is_there, state, np.nan) for name, state in states.items()}
        return replace(self, **hidden, resting=self.resting & is_there)

    def thinned(self, every: int) -> "FilmTruth":
        """Return the truth of every so many pictures."""
        of_pictures = ("times", "x", "y", "heading", "speed", "resting")
        return replace(self, **{name: getattr(self, name)[::every] for name in of_pictures})

    def save(self, path: Path) -> None:
        np.savez_compressed(path, **{name: getattr(self, name) for name in self.__slots__})

    @classmethod
    def load(cls, path: Path) -> "FilmTruth":
        with np.load(path) as stored:
            values = {name: stored[name] for name in cls.__slots__}
        values["um_px"] = float(values["um_px"])
        values["side_px"] = int(values["side_px"])
        return cls(**values)


def write_film(
    folder: Path, truth: FilmTruth, pictures: Iterator[np.ndarray], quality: int
) -> None:
    """Write a film to a new folder, as MJPEG of a quality from 0 to 100."""
    part = folder.with_name(f".{folder.name}.{os.getpid()}")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    rate = 1 / (truth.times[1] - truth.times[0])
    jpegs = [
        cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
        for picture in pictures
    ]
    (part / "film.avi").write_bytes(mjpeg(jpegs, truth.side_px, truth.side_px, rate))
    lines = [f"{t:.6f},{u:.6f}" for t, u in zip(truth.recorded, truth.turns[:, 1], strict=True)]
    (part / "field.csv").write_text("\n".join(["time_s,direction_rad", *lines, ""]))
    truth.save(part / "truth.npz")
    shutil.rmtree(folder, ignore_errors=True)
    part.rename(folder)


def mjpeg(jpegs: Sequence[bytes], width: int, height: int, rate_hz: float) -> bytes:
    """Return JPEG pictures as an AVI file; OpenCV's own writer ignores the quality."""
    count = len(jpegs)
    rate = round(rate_hz * 1000)
    code = int.from_bytes(b"MJPG", "little")
    main = (round(1e6 / rate_hz), 0, 0, 0x10, count, 0, 1, 1 << 20, width, height, *[0] * 4)
    stream = (0, 0, 0, 0, 1000, rate, 0, count, 1 << 20, 2**32 - 1, 0, *[0] * 4)
    shape = (40, width, height, 1, 24, code, 0, 0, 0, 0, 0)
    of_stream = _chunk(b"strh", b"vidsMJPG" + struct.pack("<IHHIIIIIIII4H", *stream))
    of_stream += _chunk(b"strf", struct.pack("<IiiHHIIiiII", *shape))
    headers = _chunk(b"avih", struct.pack("<14I", *main)) + _chunk(b"LIST", b"strl" + of_stream)
    frames = [_chunk(b"00dc", jpeg) for jpeg in jpegs]
    index = b""
    place = 4
    for frame, jpeg in zip(frames, jpegs, strict=True):
        index += struct.pack("<4sIII", b"00dc", 0x10, place, len(jpeg))
        place += len(frame)
    movie = _chunk(b"LIST", b"movi" + b"".join(frames)) + _chunk(b"idx1", index)
    return _chunk(b"RIFF", b"AVI " + _chunk(b"LIST", b"hdrl" + headers) + movie)


def _chunk(name: bytes, data: bytes) -> bytes:
    return name + struct.pack("<I", len(data)) + data + b"\0" * (len(data) % 2)

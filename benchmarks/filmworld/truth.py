"""A synthetic film on disk: film.avi, field.csv for `tetractl track --field`, and its truth."""

import os
import shutil
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

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
    coded = (
        cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
        for picture in pictures
    )
    write_mjpeg(part / "film.avi", coded, truth.side_px, truth.side_px, rate)
    lines = [f"{t:.6f},{u:.6f}" for t, u in zip(truth.recorded, truth.turns[:, 1], strict=True)]
    (part / "field.csv").write_text("\n".join(["time_s,direction_rad", *lines, ""]))
    truth.save(part / "truth.npz")
    shutil.rmtree(folder, ignore_errors=True)
    part.rename(folder)


def write_mjpeg(
    path: Path, pictures: Iterator[bytes], width: int, height: int, rate_hz: float
) -> None:
    """Write JPEG pictures as an AVI file; OpenCV's own writer ignores the quality."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return name + struct.pack("<I", len(data)) + data + b"\0" * (len(data) % 2)

    def headers(count: int) -> bytes:
        rate = round(rate_hz * 1000)
        main = struct.pack(
            "<14I", round(1e6 / rate_hz), 0, 0, 0x10, count, 0, 1, 1 << 20, width, height, *[0] * 4
        )
        stream = b"vidsMJPG" + struct.pack(
            "<IHHIIIIIIII4H", 0, 0, 0, 0, 1000, rate, 0, count, 1 << 20, 2**32 - 1, 0, *[0] * 4
        )
        code = int.from_bytes(b"MJPG", "little")
        shape = struct.pack("<IiiHHIIiiII", 40, width, height, 1, 24, code, 0, 0, 0, 0, 0)
        inner = chunk(b"LIST", b"strl" + chunk(b"strh", stream) + chunk(b"strf", shape))
        return chunk(b"LIST", b"hdrl" + chunk(b"avih", main) + inner)

    index = []
    place = 4
    with path.open("wb") as file:
        file.write(b"RIFF\0\0\0\0AVI " + headers(0))
        start = file.tell()
        file.write(b"LIST\0\0\0\0movi")
        for data in pictures:
            frame = chunk(b"00dc", data)
            file.write(frame)
            index.append(struct.pack("<4sIII", b"00dc", 0x10, place, len(data)))
            place += len(frame)
        file.write(chunk(b"idx1", b"".join(index)))
        end = file.tell()
        file.seek(start + 4)
        file.write(struct.pack("<I", place))
        file.seek(0)
        length = struct.pack("<I", end - 8)
        file.write(b"RIFF" + length + b"AVI " + headers(len(index)))

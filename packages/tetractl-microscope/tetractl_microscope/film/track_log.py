"""Reads the log that `tetractl track` writes of a film: its cells, their poses, and a picture."""

import io
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.message import DecodeError
from PIL import Image

from tetractl.core.clock import SECOND
from tetractl.core.errors import LogError
from tetractl.core.poses import Floats, Grey
from tetractl.core.setup import METRES
from tetractl.log.format.channels import TRACK, TRANSFORMS
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.salvage import scan
from tetractl_microscope.film.film_source import PIXELS_MAX

PROFILE = "tetractl.track"  # of the MCAP file, in its header
PICTURE = "/picture"
CELL = "cell "  # begins the name of a cell's coordinate frame, which its number ends
UM = METRES["um"]
FILM = ("pictures", "rate_hz", "um_per_px", "width", "height")  # what must be known of a film


@dataclass(frozen=True, slots=True)
class TrackLog:
    """The cells of a film.

    `record` is what `tetractl track --json` prints: the film, and `cells`. Row i of `poses` (R, 3)
    is x, y [um] and heading [rad] of the cell with the number `cell[i]` at the time `time[i]` [s].
    `picture` is the first whole picture. `damage` says what is wrong with the file.
    """

    path: str
    record: dict[str, Any]
    time: Floats
    cell: Floats
    poses: Floats
    picture: Grey
    damage: tuple[str, ...]

    @property
    def tracks(self) -> Iterator[tuple[int, Floats, Floats]]:
        """Yield number, times (K,) and poses (K, 3) of each cell that has two or more."""
        for cell in self.record["cells"]:
            (rows,) = np.nonzero(self.cell == cell["cell"])
            if len(rows) > 1:
                yield cell["cell"], self.time[rows], self.poses[rows]


def value_of(entry: Any) -> float | None:
    """Return the value of an entry of a cell, with or without an interval; None if unknown."""
    return entry["value"] if isinstance(entry, dict) else entry


def track_log_of(path: Path) -> Path | None:
    """Return the log of a film: the path itself, or `track.mcap` in a folder; None if it is not."""
    log = path / "track.mcap" if path.is_dir() else path
    if not log.is_file():
        return None
    with log.open("rb") as file:
        return log if PROFILE.encode() in file.read(64) else None


def read_track(path: Path) -> TrackLog:
    """Read the log of a film; LogError if its cells are lost or cannot be read."""
    contents = scan(path)
    try:
        record = _checked(json.loads(contents.text(TRACK) or "null"))
        rows = list(_rows(contents))
        table = np.array(rows).reshape(-1, 5)
        picture = _picture(contents, (record["height"], record["width"]))
    except (DecodeError, OSError, LookupError, RecursionError, TypeError, ValueError) as error:
        said = f"{type(error).__name__}: {error}"
        raise LogError(f"{path}: the cells of the film cannot be read: {said}") from None
    time = table[:, 0]
    cell = table[:, 1]
    poses = table[:, 2:]
    problems = (*contents.problems, *(f"lost: {lost}" for lost in contents.lost))
    return TrackLog(str(path), record, time, cell, poses, picture, problems)


def _checked(record: Any) -> dict[str, Any]:
    """Return a record whose entries have the types that tetractl writes; else ValueError."""
    for key in FILM:
        if not 0 < float(record[key]) < math.inf:
            raise ValueError(key)
    for cell in record["cells"]:
        if not isinstance(cell["cell"], int):
            raise ValueError("cell")
        for key, entry in cell.items():
            ends = entry["ci95"] if isinstance(entry, dict) else ()
            for number in (value_of(entry), *ends):
                if number is not None and not isinstance(number, bool | int | float):
                    raise ValueError(key)
    return record


def _rows(contents: RawLog) -> Iterator[tuple[float, ...]]:
    """Yield time [s], cell, x, y [um] and heading [rad] of each pose."""
    for message in contents.messages(TRANSFORMS):
        for transform in message.transforms:
            time = transform.timestamp.seconds + transform.timestamp.nanos / SECOND
            number = float(transform.child_frame_id.removeprefix(CELL))
            heading = 2 * math.atan2(transform.rotation.z, transform.rotation.w)
            yield time, number, transform.translation.x / UM, transform.translation.y / UM, heading


def _picture(contents: RawLog, shape: tuple[int, int]) -> Grey:
    """Return the first whole picture; a grey one if it is lost."""
    if not contents.by_topic[PICTURE] or shape[0] * shape[1] > PIXELS_MAX:
        return np.full((1, 1), 200, np.uint8)
    message = CompressedImage.FromString(contents.by_topic[PICTURE][0].data)
    with Image.open(io.BytesIO(message.data)) as image:
        if image.size != shape[::-1]:
            raise ValueError("picture")
        return np.array(image.convert("L"))

"""Writes the results of a film as a log for viewers, and as a film with the tracks drawn in."""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from google.protobuf.timestamp_pb2 import Timestamp
from mcap_protobuf.writer import Writer

from tetractl import __version__
from tetractl.core.clock import SECOND
from tetractl.core.colors import PALETTE
from tetractl.core.errors import TetractlError
from tetractl.core.poses import Grey
from tetractl.core.setup import METRES
from tetractl.film.follow import Followed
from tetractl.film.pictures import FilmPictures, opencv
from tetractl.lab.cameras.cells.cell import SeenCell

CROP_PX = 64
PICTURES_S = 1.0  # interval of whole pictures in the log [s]
QUALITY = 85
TRAIL = 45  # length of a trail [pictures]


def write_log(path: Path, film: FilmPictures, followed: Followed) -> None:
    """Write a log for viewers: poses as transforms in metres, a crop around each cell in each
    picture, and a whole picture per second.

    Crops are on the topics /crops/cell N, whole pictures on /picture; the background is an
    attachment.
    """
    cells = _by_picture(followed)
    every = max(1, round(PICTURES_S * followed.rate_hz))
    part = path.with_name(path.name + ".part")
    try:
        with part.open("wb") as stream, Writer(stream) as log:
            log.add_metadata(
                "tetractl.film",
                {
                    "film": str(film.path.name),
                    "tetractl": __version__,
                    "um_per_px": f"{followed.um_px:.6g}",
                    "rate_hz": f"{followed.rate_hz:g}",
                    "opencv": opencv().__version__,
                },
            )
            log.add_attachment(
                0, 0, "background.png", "image/png", _coded(followed.background, ".png")
            )
            for number, picture in film:
                ns = round(film.seconds(number) * SECOND)
                seen = cells.get(number, [])
                log.write_message("/tf", _transforms(seen, ns), ns, ns)
                for cell in seen:
                    crop = cropped(picture, cell, followed.um_px)
                    topic = f"/crops/cell {cell.identity}"
                    log.write_message(topic, _image(crop, ns, f"cell {cell.identity}"), ns, ns)
                if number % every == 0:
                    log.write_message("/picture", _image(picture, ns, "picture"), ns, ns)
        part.replace(path)
    except OSError as error:
        raise TetractlError(f"{path}: cannot be written: {error.strerror}") from error


def write_overlay(path: Path, film: FilmPictures, followed: Followed) -> None:
    """Write the film as MP4 with each cell's number, outline, heading and trail."""
    cv2 = opencv()
    cells = _by_picture(followed)
    width, height = (side - side % 2 for side in followed.size)  # MP4 needs even sides
    code = cv2.VideoWriter.fourcc(*"mp4v")
    writer = cv2.VideoWriter(str(path), code, followed.rate_hz, (width, height))
    if not writer.isOpened():
        raise TetractlError(f"{path}: OpenCV on this computer cannot write an MP4 film")
    trails: dict[int, list[tuple[int, int]]] = {}
    try:
        for number, picture in film:
            drawn = cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
            for cell in cells.get(number, []):
                _draw(drawn, cell, followed.um_px, trails.setdefault(cell.identity, []))
            writer.write(np.ascontiguousarray(drawn[:height, :width]))
    finally:
        writer.release()


def cropped(picture: Grey, cell: SeenCell, um_px: float) -> Grey:
    """Return a crop of CROP_PX x CROP_PX around a cell, black outside the picture."""
    column, row = _pixel(cell, um_px, picture.shape[0])
    half = CROP_PX // 2
    left, top = round(column) - half, round(row) - half
    crop = np.zeros((CROP_PX, CROP_PX), np.uint8)
    part = picture[max(0, top) : max(0, top + CROP_PX), max(0, left) : max(0, left + CROP_PX)]
    crop[max(0, -top) :, max(0, -left) :][: part.shape[0], : part.shape[1]] = part
    return crop


def _by_picture(followed: Followed) -> dict[int, list[SeenCell]]:
    found: dict[int, list[SeenCell]] = {}
    for path in followed.paths:
        for number, cell in zip(path.frames.tolist(), path.seen, strict=True):
            found.setdefault(number, []).append(cell)
    return found


def _pixel(cell: SeenCell, um_px: float, height: int) -> tuple[float, float]:
    return cell.x / um_px - 0.5, height - 0.5 - cell.y / um_px


def _coded(picture: Grey, kind: str) -> bytes:
    cv2 = opencv()
    options = [cv2.IMWRITE_JPEG_QUALITY, QUALITY] if kind == ".jpg" else []
    return cv2.imencode(kind, picture, options)[1].tobytes()


def _stamp(ns: int) -> Timestamp:
    return Timestamp(seconds=ns // SECOND, nanos=ns % SECOND)


def _image(picture: Grey, ns: int, frame: str) -> CompressedImage:
    data = _coded(picture, ".jpg")
    return CompressedImage(timestamp=_stamp(ns), frame_id=frame, data=data, format="jpeg")


def _transforms(cells: list[SeenCell], ns: int) -> FrameTransforms:
    message = FrameTransforms()
    for cell in cells:
        one = message.transforms.add()
        one.timestamp.CopyFrom(_stamp(ns))
        one.parent_frame_id, one.child_frame_id = "picture", f"cell {cell.identity}"
        one.translation.x, one.translation.y = cell.x * METRES["um"], cell.y * METRES["um"]
        one.rotation.z, one.rotation.w = math.sin(cell.heading / 2), math.cos(cell.heading / 2)
    return message


def _colors() -> Iterator[tuple[int, int, int]]:
    for color in PALETTE:
        red, green, blue = (int(color[i : i + 2], 16) for i in (1, 3, 5))
        yield blue, green, red


_COLORS = tuple(_colors())


def _draw(picture: np.ndarray, cell: SeenCell, um_px: float, trail: list[tuple[int, int]]) -> None:
    """Draw a cell: its trail, the outline of its body if it was found, heading and number."""
    cv2 = opencv()
    color = _COLORS[cell.identity % len(_COLORS)]
    column, row = _pixel(cell, um_px, picture.shape[0])
    at = (round(column), round(row))
    trail.append(at)
    del trail[:-TRAIL]
    cv2.polylines(picture, [np.array(trail, np.int32)], False, color, 1, cv2.LINE_AA)
    if cell.found and math.isfinite(cell.long_um):
        axes = (round(cell.long_um / 2 / um_px), round(cell.wide_um / 2 / um_px))
        cv2.ellipse(picture, at, axes, -math.degrees(cell.axis), 0, 360, color, 1, cv2.LINE_AA)
    reach = 40 / um_px
    tip = (
        round(column + reach * math.cos(cell.heading)),
        round(row - reach * math.sin(cell.heading)),
    )
    cv2.arrowedLine(picture, at, tip, color, 1, cv2.LINE_AA, tipLength=0.25)
    doubt = "" if cell.probability > 0.99 else "?"
    where = (at[0] + 8, at[1] - 8)
    cv2.putText(picture, f"{cell.identity}{doubt}", where, 0, 0.4, color, 1, cv2.LINE_AA)

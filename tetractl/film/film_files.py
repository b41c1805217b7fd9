"""Writes the results of a film: tables, a log, a figure, and a film with the tracks drawn in."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from mcap_protobuf.writer import Writer

from tetractl import __version__
from tetractl.core.clock import SECOND
from tetractl.core.colors import PALETTE
from tetractl.core.errors import TetractlError
from tetractl.core.poses import Grey
from tetractl.core.table.table_files import json_text, table_files
from tetractl.film.film_tables import pixel, pose_tables
from tetractl.film.follow import Followed
from tetractl.film.pictures import FilmPictures, opencv
from tetractl.lab.cameras.cells.cell import SeenCell
from tetractl.log.format.channels import TRACK, TRANSFORMS
from tetractl.log.format.scene import stamp
from tetractl.log.read.track_log import CELL, PICTURE, PROFILE, UM, read_track
from tetractl.results.cell_tables import cell_data
from tetractl.results.geff_file import write_geff
from tetractl.view.figures.draw import draw_cells
from tetractl.view.style import SCREEN_DPI, save

PICTURES_S = 1.0  # interval of whole pictures in the log [s]
QUALITY = 85  # of their JPEG
SIDE_PX = 768  # longest side of the film with the tracks; larger films are drawn at a fraction
TRAIL = 45  # length of a trail [pictures]

Cells = list[SeenCell]


def write_results(folder: Path, film: FilmPictures, followed: Followed, record: Any) -> None:
    """Write all results of a film into a folder; GEFF only if its package is installed."""
    poses, tracks = pose_tables(followed)
    tables = {"cells": cell_data(record), "poses": poses, "tracks": tracks}
    with table_files({name: folder / f"{name}.csv" for name in tables}, "csv") as add:
        for name, table in tables.items():
            add(name, table, "")
    cells: dict[int, Cells] = defaultdict(list)
    for path in followed.paths:
        for number, cell in zip(path.frames.tolist(), path.seen, strict=True):
            cells[number].append(cell)
    with (
        _log(folder / "track.mcap", film, followed, record) as add_picture,
        _overlay(folder / "overlay.mp4", followed) as draw,
    ):
        for number, picture in film:
            add_picture(number, picture, cells[number])
            draw(picture, cells[number])
    if followed.paths:
        log = read_track(folder / "track.mcap")
        save(draw_cells("cells", [log]), folder / "cells.png", SCREEN_DPI)
        if find_spec("geff") is not None:
            scale = followed.rate_hz, followed.um_px
            write_geff(folder / "tracks.geff", poses, tracks, followed.divisions, *scale)


@contextmanager
def _log(
    path: Path, film: FilmPictures, followed: Followed, record: Any
) -> Iterator[Callable[[int, Grey, Cells], None]]:
    """Write a log: the record as an attachment, poses as transforms in metres, a whole picture a
    second, and the background; yield the function that adds a picture.
    """
    every = max(1, round(PICTURES_S * followed.rate_hz))
    part = path.with_name(path.name + ".part")

    def add(number: int, picture: Grey, cells: Cells) -> None:
        ns = round(film.seconds(number) * SECOND)
        log.write_message(TRANSFORMS, _transforms(cells, ns), ns, ns)
        if number % every == 0 or not shown:
            shown.append(number)
            image = CompressedImage(
                timestamp=stamp(ns), frame_id="picture", data=_coded(picture), format="jpeg"
            )
            log.write_message(PICTURE, image, ns, ns)

    shown: list[int] = []
    try:
        with part.open("wb") as stream, Writer(stream, profile=PROFILE) as log:
            about = {"kind": "cells of a film", "film": film.path.name, "tetractl": __version__}
            log.add_metadata("tetractl.film", about | {"opencv": opencv().__version__})
            text = json_text(record, None).encode()
            log.add_attachment(0, 0, TRACK, "application/json", text)
            background = _coded(followed.background, ".png")
            log.add_attachment(0, 0, "background.png", "image/png", background)
            yield add
        part.replace(path)
    except OSError as error:
        raise TetractlError(f"{path}: cannot be written: {error.strerror}") from error


@contextmanager
def _overlay(path: Path, followed: Followed) -> Iterator[Callable[[Grey, Cells], None]]:
    """Write an MP4 film with each cell's number, outline, heading and trail; yield the function
    that adds a picture.
    """
    cv2 = opencv()
    shrink = math.ceil(max(followed.size) / SIDE_PX)
    width, height = (side // shrink - side // shrink % 2 for side in followed.size)
    code = cv2.VideoWriter.fourcc(*"mp4v")  # which needs even sides
    writer = cv2.VideoWriter(str(path), code, followed.rate_hz, (width, height))
    if not writer.isOpened():
        raise TetractlError(f"{path}: OpenCV on this computer cannot write an MP4 film")
    trails: dict[int, list[tuple[int, int]]] = defaultdict(list)

    def draw(picture: Grey, cells: Cells) -> None:
        size = (picture.shape[1] // shrink, picture.shape[0] // shrink)
        small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA) if shrink > 1 else picture
        drawn = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
        for cell in cells:
            _draw(drawn, cell, followed.um_px * shrink, trails[cell.identity])
        writer.write(np.ascontiguousarray(drawn[:height, :width]))

    try:
        yield draw
    finally:
        writer.release()


def _coded(picture: Grey, kind: str = ".jpg") -> bytes:
    cv2 = opencv()
    options = [cv2.IMWRITE_JPEG_QUALITY, QUALITY] if kind == ".jpg" else []
    return cv2.imencode(kind, picture, options)[1].tobytes()


def _transforms(cells: Cells, ns: int) -> FrameTransforms:
    message, time = FrameTransforms(), stamp(ns)
    for cell in cells:
        one = message.transforms.add()
        one.timestamp.CopyFrom(time)
        one.parent_frame_id, one.child_frame_id = "picture", f"{CELL}{cell.identity}"
        one.translation.x, one.translation.y = cell.x * UM, cell.y * UM
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
    column, row = pixel(cell.x, cell.y, um_px, picture.shape[0])
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

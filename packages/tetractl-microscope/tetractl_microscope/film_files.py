"""Writes the results of a film: tables, a log, a figure, and a film with the tracks drawn in."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from mcap_protobuf.writer import Writer

from tetractl import __version__
from tetractl.core.clock import SECOND
from tetractl.core.colors import PALETTE
from tetractl.core.errors import TetractlError
from tetractl.core.poses import Grey
from tetractl.log.format.channels import TRACK, TRANSFORMS
from tetractl.log.format.scene import stamp
from tetractl.tools.table.table_files import json_text, table_files
from tetractl.view.style import SCREEN_DPI, save
from tetractl_microscope.cells.cell import SeenCell
from tetractl_microscope.cells.picture_now import pixels_of
from tetractl_microscope.figures.cells import cells_figure
from tetractl_microscope.film.film_tables import pose_tables
from tetractl_microscope.film.follow import Followed
from tetractl_microscope.film.pictures import FilmPictures
from tetractl_microscope.film.track_log import CELL, PICTURE, PROFILE, UM, read_track
from tetractl_microscope.pictures.whole_pictures import LENS, WHOLE_NS, jpeg_image
from tetractl_microscope.results.cell_tables import cell_data
from tetractl_microscope.results.geff_file import write_geff

SIDE_PX = 768  # longest side of the film with the tracks; larger films are drawn at a fraction
TRAIL = 45  # length of a trail [pictures]
ARROW_UM = 40.0  # length of an arrow along a cell's heading [um]
COLORS = [tuple(reversed(bytes.fromhex(color[1:]))) for color in PALETTE]  # blue first

Cells = list[SeenCell]


def write_results(folder: Path, film: FilmPictures, followed: Followed, record: Any) -> None:
    """Write all results of a film into a folder; GEFF only if its package is installed."""
    poses, tracks = pose_tables(followed)
    tables = {"cells": cell_data(record), "poses": poses, "tracks": tracks}
    with table_files({name: folder / f"{name}.csv" for name in tables}) as add:
        for name, table in tables.items():
            add(name, table, "")
    path = folder / "track.mcap"
    cells = defaultdict[int, Cells](list)
    for path_of_cell in followed.paths:
        for _, number, cell in path_of_cell.pictures():
            cells[number].append(cell)
    try:
        _write_pictures(path, film, followed, record, cells)
    except OSError as error:
        raise TetractlError(f"{path}: cannot be written: {error.strerror}") from error
    if followed.paths:
        save(cells_figure(read_track(path)), folder / "cells.png", SCREEN_DPI)
        if find_spec("geff") is not None:
            rate_hz = followed.rate_hz if followed.timing.even else None
            path = folder / "tracks.geff"
            write_geff(path, poses, tracks, rate_hz, followed.um_px)


def _write_pictures(
    path: Path, film: FilmPictures, followed: Followed, record: Any, cells: dict[int, Cells]
) -> None:
    """Write a log: the record as an attachment, poses as transforms in metres, a whole picture a
    second, and the background; and next to it the film with the tracks drawn in.
    """
    part = path.with_name(path.name + ".part")
    with (
        part.open("wb") as stream,
        Writer(stream, profile=PROFILE) as log,
        _overlay(path.with_name("overlay.mp4"), followed) as draw,
    ):
        about = {"kind": "cells of a film", "film": film.path.name, "tetractl": __version__}
        log.add_metadata("tetractl_microscope.film", about | {"opencv": cv2.__version__})
        text = json_text(record, None).encode()
        log.add_attachment(0, 0, TRACK, "application/json", text)
        background = cv2.imencode(".png", followed.background)[1].tobytes()
        log.add_attachment(0, 0, "background.png", "image/png", background)
        due_ns = 0
        for number, picture in film:
            ns = round(film.seconds(number) * SECOND)
            log.write_message(TRANSFORMS, _transforms(cells[number], ns), ns, ns)
            if ns >= due_ns:
                due_ns = ns + WHOLE_NS
                log.write_message(PICTURE, jpeg_image(picture, stamp(ns)), ns, ns)
            draw(picture, cells[number])
    part.replace(path)


@contextmanager
def _overlay(path: Path, followed: Followed) -> Iterator[Callable[[Grey, Cells], None]]:
    """Write an MP4 film with each cell's number, outline, heading and trail; yield the function
    that adds a picture.
    """
    shrink = math.ceil(max(followed.size) / SIDE_PX)
    width, height = (side // shrink // 2 * 2 for side in followed.size)  # the format: even sides
    code = cv2.VideoWriter.fourcc(*"mp4v")
    writer = cv2.VideoWriter(str(path), code, followed.rate_hz, (width, height))
    if not writer.isOpened():
        raise TetractlError(f"{path}: OpenCV on this computer cannot write an MP4 film")
    trails: dict[int, list[tuple[int, int]]] = defaultdict(list)

    def draw(picture: Grey, cells: Cells) -> None:
        size = (picture.shape[1] // shrink, picture.shape[0] // shrink)
        small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        drawn = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
        for cell in cells:
            _draw(drawn, cell, followed.um_px * shrink, trails[cell.identity])
        writer.write(np.ascontiguousarray(drawn[:height, :width]))

    try:
        yield draw
    finally:
        writer.release()


def _transforms(cells: Cells, ns: int) -> FrameTransforms:
    message = FrameTransforms()
    time = stamp(ns)
    for cell in cells:
        transform = message.transforms.add()
        transform.timestamp.CopyFrom(time)
        transform.parent_frame_id = LENS
        transform.child_frame_id = f"{CELL}{cell.identity}"
        transform.translation.x = cell.x * UM
        transform.translation.y = cell.y * UM
        transform.rotation.z = math.sin(cell.heading / 2)
        transform.rotation.w = math.cos(cell.heading / 2)
    return message


def _draw(picture: np.ndarray, cell: SeenCell, um_px: float, trail: list[tuple[int, int]]) -> None:
    """Draw a cell: its trail, the outline of its body if it was found, heading and number."""
    look = COLORS[cell.identity % len(COLORS)], 1, cv2.LINE_AA
    ((x, y),) = pixels_of(np.array([(cell.x, cell.y)]), um_px, picture.shape[0]).tolist()
    column = round(x)
    row = round(y)
    middle = (column, row)
    trail[:] = [*trail[1 - TRAIL :], middle]
    cv2.polylines(picture, [np.array(trail, np.int32)], False, *look)
    if cell.has_blob and math.isfinite(cell.long_um):
        axes = (round(cell.long_um / 2 / um_px), round(cell.wide_um / 2 / um_px))
        cv2.ellipse(picture, middle, axes, -math.degrees(cell.axis), 0, 360, *look)
    ahead = ARROW_UM * math.cos(cell.heading), ARROW_UM * math.sin(cell.heading)
    tip = (round(column + ahead[0] / um_px), round(row - ahead[1] / um_px))
    cv2.arrowedLine(picture, middle, tip, *look, tipLength=0.25)
    doubt = "" if cell.sure else "?"
    cv2.putText(picture, f"{cell.identity}{doubt}", (column + 8, row - 8), 0, 0.4, *look)

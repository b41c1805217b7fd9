"""Writes the results of a film: tables, figures, and a film with the tracks drawn in."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tetractl import __version__
from tetractl.core.colors import PALETTE
from tetractl.core.errors import TetractlError
from tetractl.core.poses import Grey
from tetractl.tools.files import save_whole
from tetractl.tools.table.table_files import json_text, table_files
from tetractl.view.style import SCREEN_DPI, save
from tetractl_microscope.cells.cell import SeenCell
from tetractl_microscope.cells.picture_now import pixels_of
from tetractl_microscope.figures.cells import FilmTracks, cells_figure
from tetractl_microscope.film.film_tables import pose_tables
from tetractl_microscope.film.follow import Followed
from tetractl_microscope.film.pictures import FilmPictures
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
    versions = {"tetractl": __version__, "opencv": cv2.__version__}
    save_whole(folder / "cells.json", json_text(record | versions, None).encode())
    picture = _write_overlay(folder / "overlay.mp4", film, followed)
    if followed.paths:
        long_paths = [
            (path.identity, path.times, np.column_stack([path.places, path.headings]))
            for path in followed.paths
            if len(path.times) > 1
        ]
        tracks_drawn = FilmTracks(record, long_paths, picture)
        save(cells_figure(tracks_drawn), folder / "cells.png", SCREEN_DPI)
        if find_spec("geff") is not None:
            rate_hz = followed.rate_hz if followed.timing.even else None
            write_geff(folder / "tracks.geff", poses, tracks, rate_hz, followed.um_px)


def _write_overlay(path: Path, film: FilmPictures, followed: Followed) -> Grey:
    """Write the film with the tracks drawn in; return its first picture."""
    cells = defaultdict[int, Cells](list)
    for path_of_cell in followed.paths:
        for _, number, cell in path_of_cell.pictures():
            cells[number].append(cell)
    first: Grey | None = None
    with _overlay(path, followed) as draw:
        for number, picture in film:
            first = picture if first is None else first
            draw(picture, cells[number])
    assert first is not None, "a film whose cells were followed has a picture"
    return first


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

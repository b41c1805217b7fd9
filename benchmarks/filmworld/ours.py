"""What `tetractl track` says of a film, as rows to be scored; the processor time of its parts."""

import os
import time
from pathlib import Path

import numpy as np
from tetractl_microscope.cells.tracking import CellTracker
from tetractl_microscope.film.field_file import read_field
from tetractl_microscope.film.fit_cell import fit_cells
from tetractl_microscope.film.follow import Followed, follow
from tetractl_microscope.film.pictures import open_film

from .scores import Shown
from .settings import Setting, ThinnedFilm


def track(folder: Path, um_px: float, setting: Setting) -> Shown:
    """Run the pipeline of track.py on the film in a folder: decode, follow, fit."""
    began = cpu_s()
    field = read_field(folder / "field.csv") if setting.has_field else None
    film = open_film(folder / "film.avi", None, um_px)
    if setting.every > 1:
        film = ThinnedFilm(film, setting.every)
    followed = follow(film, um_px, field)
    followed, cells = fit_cells(followed, field)
    result = shown(followed)
    result.cpu_s = cpu_s() - began
    for cell in cells:
        said = {"speed": cell.speed, "a": cell.a}
        result.numbers[int(cell.cell)] = {
            name: (float(interval.low), float(interval.high))
            for name, interval in said.items()
            if interval is not None
        }
    return result


def shown(followed: Followed) -> Shown:
    """Return what is said of a film as rows."""
    rows = [
        (frame, path.identity, c.x, c.y, c.axis, c.heading, c.sure)
        for path in followed.paths
        for frame, c in zip(path.frames.tolist(), path.sightings, strict=True)
    ]
    table = np.array(sorted(rows)).reshape(-1, 7)
    frame = table[:, 0].astype(int)
    name = table[:, 1].astype(int)
    return Shown(frame, name, *table[:, 2:6].T, table[:, 6] > 0)


def parts(folder: Path, um_px: float) -> dict[str, list[float]]:
    """Return processor times a picture [ms]: those of `track`'s parts on average, and that of each
    picture from grey levels to poses in a live camera.
    """
    field = read_field(folder / "field.csv")
    marks = [cpu_s()]
    pictures = [picture for _, picture in open_film(folder / "film.avi", None, um_px)]
    marks.append(cpu_s())
    followed = follow(open_film(folder / "film.avi", None, um_px), um_px, field)
    marks.append(cpu_s())
    fit_cells(followed, field)
    marks.append(cpu_s())
    decode, find_and_link, fit = (1e3 * np.diff(marks) / len(pictures)).tolist()
    tracker = CellTracker(um_px, field_known=True)
    tracker.finder.learn(pictures[:: max(1, len(pictures) // 20)])
    live = []
    for number, picture in enumerate(pictures):
        began = time.thread_time()
        tracker.see(picture, number / followed.rate_hz, field.pieces)
        live.append(1e3 * (time.thread_time() - began))
    return {
        "decode": [decode],
        "decode and follow": [find_and_link],
        "summarise": [fit],
        "live": live,
    }


def cpu_s() -> float:
    """Return the processor time of this process and of its children that have ended [s]."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system

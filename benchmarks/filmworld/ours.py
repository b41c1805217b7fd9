"""What `tetractl track` says of a film, as rows to be scored."""

from pathlib import Path

import numpy as np
from tetractl_microscope.film.field_file import read_field
from tetractl_microscope.film.fit_cell import fit_cells
from tetractl_microscope.film.follow import Followed, follow
from tetractl_microscope.film.pictures import open_film

from .scores import Shown
from .settings import Setting, ThinnedFilm


def track(folder: Path, um_px: float, setting: Setting) -> Shown:
    """Run the pipeline of track.py on the film in a folder: decode, follow, fit."""
    field = read_field(folder / "field.csv") if setting.has_field else None
    film = open_film(folder / "film.avi", None, um_px)
    if setting.every > 1:
        film = ThinnedFilm(film, setting.every)
    followed = follow(film, um_px, field)
    followed, cells = fit_cells(followed, field)
    result = shown(followed)
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
        (frame, path.identity, c.x, c.y, c.heading, c.sure)
        for path in followed.paths
        for frame, c in zip(path.frames.tolist(), path.sightings, strict=True)
    ]
    table = np.array(sorted(rows)).reshape(-1, 6)
    frame = table[:, 0].astype(int)
    name = table[:, 1].astype(int)
    return Shown(frame, name, *table[:, 2:5].T, table[:, 5] > 0)

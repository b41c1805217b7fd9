"""Rows of a film's tracks, as `follow` enters them, and what they are made of."""

import numpy as np
from tetractl_microscope.cells.cell import SeenCell
from tetractl_microscope.film.who import TrackRow, Whereabouts


def seen_cell(name, x, y, track, likely=1.0, has_blob=True, merged=False, measured=None):
    """A cell of 50 x 25 um in one picture."""
    pose = (x, y, 0.0, 0.0)
    state = np.zeros(12)
    size = 50.0, 25.0
    return SeenCell(name, track, *pose, state, state, likely, has_blob, merged, *size, measured)


def recorded(pictures, times):
    """The record of pictures at times [s], each with its cells by track."""
    numbers = list(range(len(times)))
    where = Whereabouts(list(times), numbers)
    for picture, cells in enumerate(pictures):
        for track, cell in cells.items():
            row = TrackRow(picture, cell, cell.identity, cell.probability)
            where.tracks.setdefault(track, []).append(row)
    return where

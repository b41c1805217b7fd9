"""Rules of the tracker that can be taken out, one at a time, to see on the same films what each is
worth: `films.py rules`.
"""

import math
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from unittest.mock import patch

import numpy as np
from tetractl_microscope.cells import (
    cell_tracks,
    detect_cells,
    filter_update,
    match,
    names,
    newcomers,
    readings,
    specks,
    tracking,
)
from tetractl_microscope.cells.names import Names
from tetractl_microscope.cells.newcomers import Newcomers
from tetractl_microscope.cells.tracking import CellTracker
from tetractl_microscope.film import who
from tetractl_microscope.film.who import Whereabouts


def _no_shared_blob(cells: list, pixels: np.ndarray, blobs: list, um_px: float) -> np.ndarray:
    return np.full((len(cells), len(blobs)), match.NONE)


def _doubt_all(all_names: Names, meeting, places: dict, seconds: float) -> None:
    """End a meeting, without asking later which cell is which."""
    shares = all_names._meetings.own_shares(meeting).tolist()
    tracks = meeting.tracks
    all_names._meetings.end(meeting)
    for track, share in zip(tracks, shares, strict=True):
        all_names._doubt(track, share)


def _only_note(tracker: CellTracker, cell, newest, now) -> None:
    readings.note_own_blob(cell, newest, now.seconds)


def _at_middle(cell, newest, expected, now, body_um: float) -> readings.BlobReading:
    """Read a blob as its cell alone, also one that is too large."""
    x, y, axis, long, wide = newest.place.tolist()
    if readings._is_odd(cell, newest):
        sd_um = max(readings.ODD[0] * body_um, readings.OFF_SHARE * (long - cell.size.long))
        deviations = (sd_um, sd_um, readings.ODD[1])
    else:
        least_um = readings.POSITION_UM + readings.POSITION_PX * now.um_px
        deviations = (least_um, least_um, readings.AXIS / max(1 - wide / long, readings.ROUND))
    return readings.BlobReading(cell, newest, (x, y, axis), deviations)


RULES = {
    "a cell that stopped or turned is searched for nearby": (
        (match, "STOPPED_LEAST", match.NONE),
        (match, "STOPPED_FAR", 1e-9),
        (match, "STOPPED_REACH", 0.0),
    ),
    "size counts when blobs are assigned": ((match, "SIZE_MOST", 0.0),),
    "cells share a blob": ((match, "_shared_costs", _no_shared_blob),),
    "which cell is which is asked after a meeting": ((Names, "_resolve", _doubt_all),),
    "a cell in a blob too large may meet something unknown": (
        (CellTracker, "_note_own", _only_note),
    ),
    "something unknown joins only from the edge or a speck": (
        (CellTracker, "_may_join", lambda tracker, cell, now: False),
    ),
    "a meeting waits for what comes out": (
        (Newcomers, "awaited", lambda newcomers: []),
        (names, "REMEMBERED_S", 0.0),
    ),
    "what comes out of a blob makes its cell doubtful": (
        (Names, "come_out", lambda *arguments: None),
    ),
    "sizes tell which cell is which": ((cell_tracks, "SIZED", 0),),
    "a number ends where pictures do not show it": (
        (Whereabouts, "end_at_gaps", lambda where: None),
    ),
    "in a blob too large there is a second object": ((tracking, "own_reading", _at_middle),),
    "a blob of another size is read as less certain": (
        (readings, "_is_odd", lambda cell, newest: False),
    ),
    "a blob of another size for a second is the cell's": ((readings, "GROWN_S", math.inf),),
    "a cell often off turned: its state is uncertain": ((filter_update, "ODD_RUN", 10**9),),
    "a state far from its blob is moved to it": (
        (filter_update, "_is_astray", lambda *arguments: False),
    ),
    "a new cell is lost sooner": ((tracking, "LOST_SOON_S", tracking.LOST_S),),
    "a hidden speck may come back": ((newcomers, "HIDDEN_S", 0.0),),
    "a speck without a blob is expected where it was": ((specks, "STOPPED_S", math.inf),),
    "a speck's first step may be longer": ((match, "FIRST", match.REACH),),
    "a speck seen often is kept": ((match, "NONE_EACH", 0.0),),
    "a path begins after a jump": ((newcomers, "own_path", lambda path, size, body_um: path),),
    "a new cell swims straight": ((specks, "STRAY", math.inf),),
    "a new cell's size is even": ((specks, "EVEN", math.inf),),
    "a new cell is whole in three blobs": ((specks, "WHOLE", 1),),
    "a path has a blob in most pictures": ((who, "FOUND", 0.0),),
    "a path goes on steadily": ((who, "STEADY", 0.0),),
    "a knock moves all": ((detect_cells, "shift_of", lambda before, now: (0.0, 0.0)),),
    "a body only in the background is none": (
        (detect_cells, "_is_ghost", lambda *arguments: False),
    ),
    "the background is kept around cells": (
        (CellTracker, "_surroundings", lambda tracker, now: []),
    ),
    "a region may be several bodies": ((detect_cells, "BODIES", 1),),
}
"""What replaces what (module or class, name, value) if a rule is taken out."""


@contextmanager
def without(rule: str) -> Iterator[None]:
    """Take a rule out for a time, none if it is empty."""
    with ExitStack() as taken_out:
        for owner, name, value in RULES.get(rule, ()):
            taken_out.enter_context(patch.object(owner, name, value))
        yield

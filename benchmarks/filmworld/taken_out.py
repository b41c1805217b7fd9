"""Rules of the tracker that can be taken out, one at a time, to see on the same films what each is
worth: `films.py ... --without RULE`.
"""

import math

import numpy as np
from tetractl_microscope.cells import detect_cells, match, newcomers, readings, specks, tracking
from tetractl_microscope.cells.names import Names
from tetractl_microscope.cells.tracking import CellTracker
from tetractl_microscope.film.who import Whereabouts


def _no_shared_blob(cells: list, pixels: np.ndarray, blobs: list, um_px: float) -> np.ndarray:
    return np.full((len(cells), len(blobs)), match.NONE)


RULES = {
    "a cell that stopped or turned is searched for nearby": (
        (match, "STOPPED_LEAST", match.NONE),
        (match, "STOPPED_FAR", match.NO_REACH),
        (match, "STOPPED_REACH", 0.0),
    ),
    "cells share a blob": ((match, "_shared_costs", _no_shared_blob),),
    "a number ends where pictures do not show it": (
        (Whereabouts, "end_at_gaps", lambda where: None),
    ),
    "a path begins after a jump": ((newcomers, "own_path", lambda path, size, body_um: path),),
    "the least likely cell leaves a small shared blob": (
        (CellTracker, "_left_unseen", lambda tracker, seconds: ()),
    ),
    "a blob of another size for a second is the cell's": ((readings, "GROWN_S", math.inf),),
    "what does not swim in time is no cell": (
        (CellTracker, "_stays", lambda tracker, cell, now: False),
    ),
    "a new cell is lost sooner": ((tracking, "LOST_SOON_S", tracking.LOST_S),),
    "a hidden speck may come back": ((newcomers, "HIDDEN_S", 0.0),),
    "a lost cell may come back": ((Names, "_come_back", lambda *arguments: None),),
    "near a cell more blobs are needed": ((newcomers, "NEAR_BORN", specks.BORN),),
    "a body only in the background is none": (
        (detect_cells, "_is_ghost", lambda *arguments: False),
    ),
}
"""What replaces what (module or class, name, value) if a rule is taken out."""


def take_out(rule: str) -> None:
    """Take a rule out of this process, none if it is empty."""
    for owner, name, value in RULES[rule] if rule else ():
        setattr(owner, name, value)

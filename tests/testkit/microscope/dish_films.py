"""Short synthetic films, with measures of how well the live tracker follows their cells."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from tetractl_emulator.pictures.dish.picture import PictureLook
from tetractl_microscope.cells.field_record import FieldRecord
from tetractl_microscope.cells.tracking import CellTracker
from tetractl_microscope.organisms import TETRAHYMENA
from tetractl_microscope.tracks.field_file import no_field

from testkit.microscope.needs_opencv import cv2
from testkit.microscope.synthetic_film import FilmScript, SyntheticFilm
from tetractl.core.poses import wrap

REACH_UM = 25.0  # a cell is found by what is shown within half a body of it
LEARNED = 15  # pictures from which the background is computed
LEARNING_S = 1.5  # time in which they are taken
KNOWN_S = 1.0  # time after which the tracker has recognised what swims

cv2.setNumThreads(1)


def film(seed=1, side=384, look=None, **script):
    """A film of a small picture; `look` are values that are not drawn."""
    drawn = PictureLook.sample(np.random.default_rng(seed), side, 2.3)
    values = {name: getattr(drawn, name) for name in drawn.__slots__} | (look or {})
    options = {"seconds": 4.0, "cells": 4, "events": False} | script
    return SyntheticFilm(FilmScript(**options), PictureLook(**values), seed)


def record(synthetic):
    """The field of a film."""
    times, directions = synthetic.turns.T
    return FieldRecord(times, directions)


@dataclass
class Followed:
    """What the live tracker saw in each `every`-th picture of a film."""

    tracker: CellTracker
    every: int
    seen: list  # of the cells in each picture


def followed(synthetic, field_known=True, organism=TETRAHYMENA, every=1, slower=1.0):
    """Follow the cells of a film that is played `slower` by a factor."""
    pictures = list(synthetic.pictures())[::every]
    tracker = CellTracker(synthetic.look.um_px, field_known, organism=organism)
    first = pictures[: int(np.searchsorted(synthetic.times[::every], LEARNING_S))]
    tracker.finder.learn(first[:: max(1, len(first) // LEARNED)])
    pieces = record(synthetic).pieces if field_known else no_field
    times = slower * synthetic.times[::every]
    seen = [
        tracker.track_image(grey, t, pieces)
        for grey, t in zip(pictures, times.tolist(), strict=True)
    ]
    return Followed(tracker, every, seen)


@dataclass
class Score:
    """How well cells were followed, from KNOWN_S on.

    Attributes:
        found: Share of the cells in view that are found.
        false: Share of what is shown that is no cell.
        kept: Share of the found cells that have the number under which they were first found.
        off_um: Distances of found cells from their true places.
        turned: Errors of the headings of found cells [rad].
        axis_off: Errors of the axes of found cells [rad]; an axis is the same after half a turn.
    """

    found: float
    false: float
    kept: float
    off_um: np.ndarray
    turned: np.ndarray
    axis_off: np.ndarray


def scored(synthetic, tracked):
    """Compare what was followed with the film's truth."""
    body = synthetic.body[:: tracked.every]
    heading = synthetic.heading[:: tracked.every]
    in_view = synthetic.in_view[:: tracked.every]
    times = synthetic.times[:: tracked.every]
    first_number = {}
    rows = []
    missed = 0
    false = 0
    for k in np.flatnonzero(times >= KNOWN_S).tolist():
        cells = tracked.seen[k]
        there = np.flatnonzero(np.isfinite(body[k, :, 0]))
        places = np.array([(cell.x, cell.y) for cell in cells]).reshape(-1, 2)
        apart = np.linalg.norm(body[k, there, None, :2] - places[None], axis=2)
        chosen = zip(*linear_sum_assignment(np.minimum(apart, REACH_UM)), strict=True)
        pairs = [(there[i], j) for i, j in chosen if apart[i, j] < REACH_UM]
        found = {i for i, _ in pairs}
        false += len(cells) - len(pairs)
        missed += sum(i not in found for i in np.flatnonzero(in_view[k]).tolist())
        for i, j in pairs:
            cell = cells[j]
            x, y, axis = body[k, i]
            is_kept = first_number.setdefault(i, cell.identity) == cell.identity
            off_um = np.hypot(cell.x - x, cell.y - y)
            axis_off = wrap(2 * (cell.axis - axis)) / 2
            rows.append((is_kept, off_um, wrap(cell.heading - heading[k, i]), axis_off))
    is_kept, off_um, turned, axis_off = np.array(rows).T
    count = len(rows)
    shares = count / (count + missed), false / (count + false), is_kept.mean()
    return Score(*shares, off_um, turned, axis_off)

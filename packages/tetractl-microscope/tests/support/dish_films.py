"""Short synthetic films for tests, and how well cells were followed in them."""

from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment
from support.needs_opencv import cv2
from support.synthetic_film import FilmScript, SyntheticFilm
from tetractl_emulator.pictures.dish.picture import PictureLook
from tetractl_microscope.film.field_file import FieldRecord
from tetractl_microscope.film.follow import follow
from tetractl_microscope.film.picture_times import PictureTimes

from tetractl.core.poses import wrap

REACH_UM = 25.0  # a cell is found by what is shown within half a body of it
TOGETHER_UM = 40.0  # bodies nearer to each other than this are one blob
GAP = 3  # pictures out of sight, after which a cell may have another number

cv2.setNumThreads(1)


class Reel:
    """A film in memory, as `follow` takes one."""

    def __init__(self, synthetic, pictures=None, timing=None):
        self.path = "reel"
        self.damaged = 0
        self.timing = PictureTimes(synthetic.script.rate) if timing is None else timing
        self.pictures = list(synthetic.pictures()) if pictures is None else pictures

    def __iter__(self):
        return iter(enumerate(self.pictures))

    @property
    def rate_hz(self):
        return self.timing.rate_hz

    def seconds(self, number):
        return self.timing.seconds(number)

    def time_line(self):
        return self.timing.uneven_line()


def film(seed=1, side=384, look=None, **script):
    """A film of a small picture; `look` are values that are not drawn."""
    drawn = PictureLook.drawn(np.random.default_rng(seed), side, 2.3)
    values = {name: getattr(drawn, name) for name in drawn.__slots__} | (look or {})
    options = {"seconds": 4.0, "cells": 4, "events": False} | script
    return SyntheticFilm(FilmScript(**options), PictureLook(**values), seed)


def record(synthetic):
    """The field of a film."""
    times, directions = synthetic.turns.T
    return FieldRecord(times, directions)


def followed(synthetic, field_known=True):
    """What is said of a film."""
    field_record = record(synthetic) if field_known else None
    return follow(Reel(synthetic), synthetic.look.um_px, field_record)


def who(synthetic, path):
    """Which cell of a film a path is of, by most of its pictures."""
    votes = []
    for k, cell in zip(path.frames, path.sightings, strict=True):
        places = np.nan_to_num(synthetic.body[k, :, :2], nan=1e6)
        gaps = np.linalg.norm(places - (cell.x, cell.y), axis=1)
        if gaps.min() < REACH_UM:
            votes.append(int(gaps.argmin()))
    return max(set(votes), key=votes.count) if votes else None


@dataclass
class NumbersSoFar:
    """What the numbers of an earlier picture say: `number_of` is that of each true cell when it was
    last alone, `last_picture` when it was last in a blob, `cell_of` the true cell that had a number
    last.
    """

    number_of: dict = field(default_factory=dict)
    last_picture: dict = field(default_factory=dict)
    cell_of: dict = field(default_factory=dict)

    def forget(self, in_view, picture):
        """Forget cells that are out of sight for so long that they may get another number."""
        for i in list(self.number_of):
            if i not in in_view and picture - self.last_picture[i] > GAP:
                del self.number_of[i]

    def note(self, i, number, picture):
        """Note the number of a cell that is alone in a picture."""
        self.number_of[i] = number
        self.last_picture[i] = picture
        self.cell_of[number] = i


@dataclass
class Score:
    """How films were followed: errors of free cells in position [um], axis and heading [rad], cells
    in view that were `right`, `missed` or are none (`extra`), the numbers of each cell by its row,
    and the probability stated where a cell got another number, `changed`, and where it got one that
    was another cell's, `taken`. While cells share a blob, their numbers do not count."""

    position: list = field(default_factory=list)
    axis: list = field(default_factory=list)
    heading: list = field(default_factory=list)
    right: int = 0
    missed: int = 0
    extra: int = 0
    numbers: dict = field(default_factory=dict)
    changed: list = field(default_factory=list)
    taken: list = field(default_factory=list)

    @property
    def f1(self):
        return 2 * self.right / max(2 * self.right + self.missed + self.extra, 1)

    def add(self, synthetic, followed):
        """Compare what was said of a film with the truth; return this."""
        cells_in = [[] for _ in synthetic.times]
        for path in followed.paths:
            for k, cell in zip(path.frames, path.sightings, strict=True):
                cells_in[k].append(cell)
        so_far = NumbersSoFar()
        self.numbers = {}
        for k, cells in enumerate(cells_in):
            in_view = np.flatnonzero(synthetic.in_view[k]).tolist()
            so_far.forget(in_view, k)
            places = synthetic.body[k, :, :2]
            pairs = matched(places, cells, so_far.number_of)
            cell_of = {i: cells[pairs[i]] for i in in_view if i in pairs}
            self.right += len(cell_of)
            self.missed += len(in_view) - len(cell_of)
            self.extra += len(cells) - len(pairs)
            for i, cell in cell_of.items():
                if cell.merged or together(places, i):
                    so_far.last_picture[i] = k
                    continue
                if not divides(synthetic, i):
                    self._add_changes(i, cell, so_far)
                so_far.note(i, cell.identity, k)
                self.numbers.setdefault(i, []).append(cell.identity)
                if cell.has_blob:
                    self._add_errors(synthetic, k, i, cell)
        return self

    def _add_changes(self, i, cell, so_far):
        """Add the stated probability, if the number of a cell is another than before."""
        if so_far.number_of.get(i, cell.identity) != cell.identity:
            self.changed.append(cell.probability)
        if so_far.cell_of.get(cell.identity, i) != i:
            self.taken.append(cell.probability)

    def _add_errors(self, synthetic, k, i, cell):
        """Add the errors of a cell's pose in picture k; a resting cell's heading has no truth."""
        x, y, axis = synthetic.body[k, i]
        self.position.append((cell.x - x, cell.y - y))
        # an axis is the same after half a turn
        self.axis.append(wrap(2 * (cell.axis - axis)) / 2)
        if not rests(synthetic, i):
            self.heading.append(wrap(cell.heading - synthetic.heading[k, i]))


def divides(synthetic, i):
    """Whether a cell divides in a film, or is the daughter, which comes last."""
    mother = synthetic.script.cells - 2
    daughter = synthetic.body.shape[1] - 1
    return synthetic.script.events and i in (mother, daughter)


def rests(synthetic, i):
    """Whether a cell rests for a while in a film."""
    return synthetic.script.events and i == synthetic.script.cells - 1


def together(places, i):
    """Whether a cell's body is in one blob with another one's."""
    gaps = np.linalg.norm(np.nan_to_num(places, nan=1e6) - places[i], axis=1)
    return np.sort(gaps)[1:].min(initial=np.inf) < TOGETHER_UM


def matched(places, cells, last):
    """Which cell shown is which true one; one that was matched before stays so within reach."""
    said = np.array([(cell.x, cell.y) for cell in cells]).reshape(-1, 2)
    true = np.nan_to_num(places, nan=1e6)
    gaps = np.linalg.norm(true[:, None] - said[None], axis=-1)
    cost = np.minimum(gaps, 1e5)
    for i, number in last.items():
        for j, cell in enumerate(cells):
            if cell.identity == number and gaps[i, j] < REACH_UM:
                cost[i, j] -= 1e6
    assigned = np.transpose(linear_sum_assignment(cost)).tolist()
    return {i: j for i, j in assigned if gaps[i, j] < REACH_UM}

"""Short synthetic films for tests, and how well cells were followed in them."""

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment
from support.needs_opencv import cv2
from support.synthetic_film import FilmScript, SyntheticFilm
from tetractl_emulator.pictures.dish.picture import PictureLook
from tetractl_microscope.film.field_file import FieldRecord
from tetractl_microscope.film.follow import follow
from tetractl_microscope.film.picture_times import PictureTimes

REACH_UM = 25.0  # a cell is found by what is shown within half a body of it
TOGETHER_UM = 40.0  # bodies nearer to each other than this are one blob
GAP = 3  # pictures out of sight, after which a cell may have another number

cv2.setNumThreads(1)


class Reel:
    """A film in memory, as `follow` takes one."""

    def __init__(self, made, pictures=None, timing=None):
        self.path = "reel"
        self.damaged = 0
        self.timing = PictureTimes(made.script.rate) if timing is None else timing
        self.pictures = list(made.pictures()) if pictures is None else pictures

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


def record(made):
    """The field of a film."""
    return FieldRecord(made.turns[:, 0], np.cos(made.turns[:, 1]), np.sin(made.turns[:, 1]))


def followed(made, known=True):
    """What is found of a film."""
    return follow(Reel(made), made.look.um_px, record(made) if known else None)


def who(made, path):
    """Which cell of a film a path is of, by most of its pictures."""
    votes = []
    for k, cell in zip(path.frames, path.sightings, strict=True):
        gaps = np.linalg.norm(
            np.nan_to_num(made.body[k, :, :2], nan=1e6) - (cell.x, cell.y), axis=1
        )
        votes += [int(gaps.argmin())] if gaps.min() < REACH_UM else []
    return max(set(votes), key=votes.count) if votes else None


@dataclass
class Score:
    """How films were followed: errors of free cells in position [um], axis and heading [rad], cells
    seen that were `found`, `missed` or are none (`extra`), the numbers of each cell by its row, and
    the probability stated where a cell got another number, `changed`, and where it got one that was
    another cell's, `taken`. While cells share a blob, their numbers do not count."""

    position: list = field(default_factory=list)
    axis: list = field(default_factory=list)
    heading: list = field(default_factory=list)
    found: int = 0
    missed: int = 0
    extra: int = 0
    numbers: dict = field(default_factory=dict)
    changed: list = field(default_factory=list)
    taken: list = field(default_factory=list)

    @property
    def f1(self):
        return 2 * self.found / max(2 * self.found + self.missed + self.extra, 1)

    def add(self, made, followed):
        """Compare what was found in a film with the truth; return this."""
        shown = [[] for _ in made.times]
        last = {}
        when = {}
        of = {}
        self.numbers = {}
        for path in followed.paths:
            for k, cell in zip(path.frames, path.sightings, strict=True):
                shown[k].append(cell)
        events = made.script.events
        divides = made.script.cells - 2
        rests = made.script.cells - 1
        for k, cells in enumerate(shown):
            seen = [int(i) for i in np.flatnonzero(made.seen[k])]
            for i in [i for i in last if i not in seen and k - when[i] > GAP]:
                del last[i]
            pairs = matched(made.body[k, :, :2], cells, last)
            self.found += sum(i in pairs for i in seen)
            self.missed += sum(i not in pairs for i in seen)
            self.extra += len(cells) - len(pairs)
            for i in seen:
                if i not in pairs:
                    continue
                cell = cells[pairs[i]]
                body = made.body[k, i]
                if cell.merged or together(made.body[k, :, :2], i):
                    when[i] = k
                    continue
                if not (events and i in (divides, made.body.shape[1] - 1)):
                    changed = last.get(i, cell.identity) != cell.identity
                    self.changed += [cell.probability] if changed else []
                    other = of.get(cell.identity, i) != i
                    self.taken += [cell.probability] if other else []
                last[i] = cell.identity
                when[i] = k
                of[cell.identity] = i
                self.numbers.setdefault(i, []).append(cell.identity)
                if cell.has_blob:
                    self.position.append((cell.x - body[0], cell.y - body[1]))
                    self.axis.append((cell.axis - body[2] + math.pi / 2) % math.pi - math.pi / 2)
                    off = (cell.heading - made.heading[k, i] + math.pi) % (2 * math.pi) - math.pi
                    self.heading += [] if events and i == rests else [off]
        return self


def together(places, i):
    """Whether a cell's body is in one blob with another one's."""
    gaps = np.linalg.norm(np.nan_to_num(places, nan=1e6) - places[i], axis=1)
    return np.sort(gaps)[1:].min(initial=np.inf) < TOGETHER_UM


def matched(places, cells, last):
    """Which cell shown is which true one; one that was matched before stays so within reach."""
    there = np.array([(c.x, c.y) for c in cells]).reshape(-1, 2)
    gaps = np.linalg.norm(np.nan_to_num(places, nan=1e6)[:, None] - there[None], axis=-1)
    cost = np.minimum(gaps, 1e5)
    for i, number in last.items():
        for j, cell in enumerate(cells):
            if cell.identity == number and gaps[i, j] < REACH_UM:
                cost[i, j] -= 1e6
    own, near = linear_sum_assignment(cost)
    return {int(i): int(j) for i, j in zip(own, near, strict=True) if gaps[i, j] < REACH_UM}

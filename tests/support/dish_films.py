"""Short synthetic films for tests, and how well cells were followed in them."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from support.needs_opencv import cv2

from tetractl.emulate.dish.picture import PictureLook
from tetractl.emulate.dish.synthetic import FilmScript, SyntheticFilm
from tetractl.film.field_file import FieldRecord
from tetractl.film.follow import follow

REACH_UM = 25.0  # a cell is found by what is shown within half a body of it

cv2.setNumThreads(1)


class Reel:
    """A film in memory, as `follow` takes one."""

    def __init__(self, made, pictures=None):
        self.path, self.rate_hz, self.damaged = "reel", made.script.rate, 0
        self.pictures = list(made.pictures()) if pictures is None else pictures

    def __iter__(self):
        return iter(enumerate(self.pictures))


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
    for k, cell in zip(path.frames, path.seen, strict=True):
        gaps = np.linalg.norm(
            np.nan_to_num(made.body[k, :, :2], nan=1e6) - (cell.x, cell.y), axis=1
        )
        votes += [int(gaps.argmin())] if gaps.min() < REACH_UM else []
    return max(set(votes), key=votes.count) if votes else None


@dataclass
class Score:
    """Position and axis errors of free cells [um, rad], heading errors, F1, numbers by cell."""

    position: np.ndarray
    axis: np.ndarray
    heading: np.ndarray
    f1: float
    numbers: dict


def score(made, found):
    """Compare what was found with the truth."""
    shown = [[] for _ in made.times]
    for path in found.paths:
        for k, cell in zip(path.frames, path.seen, strict=True):
            shown[k].append(cell)
    position, axis, heading, hits, misses, extra, numbers = [], [], [], 0, 0, 0, {}
    for k, cells in enumerate(shown):
        truth = made.body[k]
        there = np.array([(c.x, c.y) for c in cells]).reshape(-1, 2)
        gaps = np.linalg.norm(np.nan_to_num(truth[:, None, :2], nan=1e6) - there[None], axis=-1)
        own, near = linear_sum_assignment(gaps)
        pairs = {int(i): int(j) for i, j in zip(own, near, strict=True) if gaps[i, j] < REACH_UM}
        seen = [int(i) for i in np.flatnonzero(made.seen[k])]
        hits += sum(i in pairs for i in seen)
        misses += sum(i not in pairs for i in seen)
        extra += len(cells) - len(pairs)
        for i in seen:
            if i not in pairs:
                continue
            cell = cells[pairs[i]]
            numbers.setdefault(i, []).append(cell.identity)
            if cell.found and not cell.merged:
                position.append((cell.x - truth[i, 0], cell.y - truth[i, 1]))
                axis.append((cell.axis - truth[i, 2] + math.pi / 2) % math.pi - math.pi / 2)
                off = cell.heading - made.heading[k, i]
                heading.append((off + math.pi) % (2 * math.pi) - math.pi)
    f1 = 2 * hits / max(2 * hits + misses + extra, 1)
    return Score(np.array(position), np.array(axis), np.array(heading), f1, numbers)

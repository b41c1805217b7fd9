"""Short synthetic films for tests, and how well cells were followed in them."""

import numpy as np
from filmworld.in_memory import FilmInMemory
from filmworld.scores import Shown, score_film
from filmworld.truth import FilmTruth
from support.needs_opencv import cv2
from support.synthetic_film import FilmScript, SyntheticFilm
from tetractl_emulator.pictures.dish.picture import PictureLook
from tetractl_microscope.cells.field_record import FieldRecord
from tetractl_microscope.film.follow import follow
from tetractl_microscope.film.picture_times import PictureTimes

from tetractl.core.poses import wrap

REACH_UM = 25.0  # a cell is found by what is shown within half a body of it

cv2.setNumThreads(1)


class Reel(FilmInMemory):
    """A synthetic film, or other pictures and times of it."""

    def __init__(self, synthetic, pictures=None, timing=None):
        pictures = list(synthetic.pictures()) if pictures is None else pictures
        timing = PictureTimes(synthetic.script.rate) if timing is None else timing
        super().__init__("reel", pictures, timing)


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


def scored(synthetic, tracked, every=1):
    """How well cells were followed in a film of which each `every`-th picture was seen."""
    x, y, _ = np.moveaxis(synthetic.body, 2, 0)
    resting = np.zeros(x.shape, bool)
    if synthetic.script.events:
        resting[:, synthetic.script.cells - 1] = True  # for a while, in which it has no heading
    truth = FilmTruth(
        times=synthetic.times,
        x=x,
        y=y,
        heading=synthetic.heading,
        speed=np.zeros_like(x),
        resting=resting,
        a=np.zeros(x.shape[1]),
        parent=np.full(x.shape[1], -1),
        turns=synthetic.turns,
        recorded=synthetic.turns[:, 0],
        um_px=synthetic.look.um_px,
        side_px=synthetic.look.width,
    )
    return score_film("film", truth.thinned(every), Shown.of(tracked))


def axis_errors(synthetic, tracked):
    """How far axes of cells with a blob are off [rad]; an axis is the same after half a turn."""
    errors = []
    for path in tracked.paths:
        i = who(synthetic, path)
        for k, cell in zip(path.frames, path.sightings, strict=True):
            if cell.has_blob and i is not None:
                errors.append(wrap(2 * (cell.axis - synthetic.body[k, i, 2])) / 2)
    return np.abs(errors)

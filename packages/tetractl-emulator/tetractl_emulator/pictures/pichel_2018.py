"""Pichel and others, Magnetic response of Magnetospirillum gryphiswaldense, arXiv 1710.00405.

How fast bacteria turn in fields of 1 to 12 mT, from films of their U-turns in a channel of 5 um.
Here the films are emulated, one per strength, and followed as by `tetractl track`. So the slope of
a against B is put in, drawn for each set of films, and what is shown is the method.
"""

import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from tetractl_microscope.film.field_file import read_field
from tetractl_microscope.film.fit_cell import CellSummary, fit_cells
from tetractl_microscope.film.follow import follow
from tetractl_microscope.film.pictures import open_film
from tetractl_microscope.organisms import MAGNETOSPIRILLUM
from tetractl_papers.claim import Claim, Fate, as_often, at_most
from tetractl_papers.paper import Paper, Work

from tetractl.core.poses import Floats, Grey
from tetractl.model.swimmers import Swimmers, bodies
from tetractl_emulator.pictures.dish.picture import SUB_EXPOSURES, DishPainter, PictureLook

STRENGTHS_MT = (1.0, 2.0, 4.0, 6.0, 9.0, 12.0)
CELLS = 34
SLOPES = 0.5, 1.0
"""Range of the slopes put in [rad/(mT s)], which the fit does not know."""
SPREAD = 0.15
"""Assumed standard deviation of ln of the slope among cells."""
WALK = 0.1
"""Assumed standard deviation of headings [rad/sqrt(s)]."""
LOOK = PictureLook(width=768, height=768, um_px=0.25, vignetting=0.1)
RATE_HZ = 15
HOLD_S = 3.0
REVERSALS = 4
REFERENCE_MT = 4.0
"""The strength for which `track` states a: a field's file has strengths relative to it."""
ROUNDS = 20
"""How often outliers are looked for again."""
OUTLIER = 3.0
"""Deviations beyond which a track is left out: it is of more cells than one."""


def _bacteria(slope: float, rng: np.random.Generator) -> Swimmers:
    cells = Swimmers.drawn(rng, CELLS)
    span = LOOK.width * LOOK.um_px
    cells.x[:], cells.y[:] = rng.uniform(0.15 * span, 0.85 * span, (2, CELLS))
    cells.length[:] = rng.normal(5, 0.5, CELLS)
    cells.width[:] = rng.normal(0.7, 0.05, CELLS)
    cells.speed[:] = 32 * np.exp(rng.normal(0, 0.2, CELLS))
    cells.helix_um[:] = 0.1
    cells.helix_hz[:] = 2.0
    cells.walk[:] = WALK
    cells.a[:] = slope * np.exp(rng.normal(-(SPREAD**2) / 2, SPREAD, CELLS))  # at 1 mT
    return cells


def _pictures(
    cells: Swimmers, field: Sequence[complex], rng: np.random.Generator
) -> Iterator[Grey]:
    """Yield pictures of cells in a field [mT], given for each picture."""
    painter = DishPainter(LOOK, int(rng.integers(2**32)))
    for number, now in enumerate(field):
        cells.depth[:] = 0.0  # the channel is so shallow that all are in focus
        moments = [bodies(cells)] * SUB_EXPOSURES
        yield painter.picture(cells, moments, np.ones(len(cells), bool), number / RATE_HZ)
        cells.swim((now.real, now.imag), 1 / RATE_HZ, rng)


def _tracked(strength: float, slope: float, rng: np.random.Generator) -> Sequence[CellSummary]:
    """Return what `track` says of the cells of a film with a field that reverses."""
    count = round(REVERSALS * HOLD_S * RATE_HZ)
    axis = rng.uniform(-math.pi, math.pi)
    angles = [axis + math.pi * (k // round(HOLD_S * RATE_HZ)) for k in range(count)]
    field = [strength * complex(math.cos(u), math.sin(u)) for u in angles]
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder, "film.avi")
        record = Path(folder, "field.csv")
        code = cv2.VideoWriter.fourcc(*"MJPG")
        size = (LOOK.width, LOOK.height)
        writer = cv2.VideoWriter(str(film), code, RATE_HZ, size, isColor=False)
        for picture in _pictures(_bacteria(slope, rng), field, rng):
            writer.write(picture)
        writer.release()
        rows = [f"{k / RATE_HZ},{u},{strength / REFERENCE_MT}" for k, u in enumerate(angles)]
        record.write_text("\n".join(["time_s,direction_rad,strength", *rows, ""]))
        field_of_film = read_field(record)
        followed = follow(
            open_film(film, None, LOOK.um_px), LOOK.um_px, field_of_film, MAGNETOSPIRILLUM
        )
        return fit_cells(followed, field_of_film)[1]


def fitted(slopes: Floats, deviations: Floats) -> tuple[float, float, float]:
    """Return the mean of the slopes a / B of tracks (T,), the ends of its 95 % interval by
    Student's t.

    It is the line through the origin of a on B, each track weighted by its own variance and the
    variance among cells. Tracks over OUTLIER deviations away are left out.
    """
    from scipy import stats  # slow to import

    middle = float(np.median(slopes))
    deviation = float(np.median(np.abs(slopes - middle)))
    among = deviation / stats.norm.ppf(0.75)
    weights = 1 / (among**2 + deviations**2)
    is_near = np.abs(slopes - middle) * np.sqrt(weights) < OUTLIER
    for _ in range(ROUNDS):
        middle = float(np.average(slopes[is_near], weights=weights[is_near]))
        is_near = np.abs(slopes - middle) * np.sqrt(weights) < OUTLIER
    share_of = weights[is_near] / weights[is_near].sum()
    error = float(np.sqrt(np.sum((share_of * (slopes[is_near] - middle)) ** 2)))
    half = float(stats.t.ppf(0.975, is_near.sum() - 1)) * error
    return middle, middle - half, middle + half


def films(seed: int, number: int) -> dict[str, Any]:
    """Return the slope put into a set of films, one per strength, and a / B of each track with its
    standard deviation [rad/(mT s)]."""
    from scipy import stats  # slow to import

    rng = np.random.default_rng([seed, number])
    put_in = float(rng.uniform(*SLOPES))
    cells = [cell for mt in STRENGTHS_MT for cell in _tracked(mt, put_in, rng)]
    couplings = [cell.a_rad_s for cell in cells if cell.a_rad_s is not None and cell.sure]
    deviations = [(a.high - a.low) / 2 / stats.norm.ppf(0.975) / REFERENCE_MT for a in couplings]
    slopes = [a.value / REFERENCE_MT for a in couplings]
    return {"put in": put_in, "slopes": slopes, "deviations": deviations}


def interval_width(films_of_set: Mapping[str, Any]) -> float:
    """Return the width of the slope's interval [rad/(mT s)] of a set of films."""
    _, low, high = _fitted_to(films_of_set)
    return high - low


def misses_slope(films_of_set: Mapping[str, Any]) -> bool:
    """Return whether the interval of a set of films does not hold the slope that was put in."""
    _, low, high = _fitted_to(films_of_set)
    return not low <= films_of_set["put in"] <= high


def _fitted_to(films_of_set: Mapping[str, Any]) -> tuple[float, float, float]:
    return fitted(np.array(films_of_set["slopes"]), np.array(films_of_set["deviations"]))


PAPER = Paper(
    source="Pichel and others, 2018: turning rate against the field's strength (emulated films; "
    "the slope is put in)",
    arms={"films": Work(films)},
    claims=[
        Claim(
            figure="a over B: width of its interval, 204 cells",
            published="0.06 rad/(mT s), of 0.74 +- 0.03",
            arm="films",
            measure=interval_width,
            unit="rad/(mT s)",
            asked=at_most(0.06),
        ),
        Claim(
            figure="a over B: the slope put in is not in its interval",
            published="in 5 %, as the interval is of 95 %",
            arm="films",
            measure=misses_slope,
            asked=as_often(0.05),
            expected=Fate.AGREES,
        ),
    ],
)

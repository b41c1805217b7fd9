"""Reproduces how fast bacteria turn in magnetic fields, after Pichel and others (2018).

The paper, Magnetic response of Magnetospirillum gryphiswaldense (arXiv 1710.00405), measures how
fast bacteria turn in fields of 1 to 12 mT, from their U-turns in a channel of 5 um. Here the tracks
are simulated, one table for each field strength, and fitted as by `tetractl track`. The slope of
the turning rate a against the field strength B is an input, sampled for each set of tables, so the
result only shows that the method works.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from tetractl_papers.claim import Claim, Fate, as_often, mean_of, not_judged
from tetractl_papers.paper import Paper, Work

from tetractl.core.poses import Floats
from tetractl.model.swimmers import Swimmers, bodies
from tetractl_microscope.cells.field_record import FieldRecord
from tetractl_microscope.organisms import MAGNETOSPIRILLUM
from tetractl_microscope.tracks.fit_track import CellPath, CellSummary, fit_tracks

STRENGTHS_MT = (1.0, 2.0, 4.0, 6.0, 9.0, 12.0)
CELLS = 34
SLOPES = 0.5, 1.0
"""Range of the simulated slopes [rad/(mT s)], which the fit does not know."""
SPREAD = 0.15
"""Assumed standard deviation of ln of the slope among cells."""
WALK = 0.1
"""Assumed standard deviation of headings [rad/sqrt(s)]."""
NOISE_UM = 0.1
"""Assumed standard deviation of each coordinate of a tracked position [um]."""
RATE_HZ = 15
HOLD_S = 3.0
REVERSALS = 4
REFERENCE_MT = 4.0
"""The field strength for which `track` states a [mT].

A file of the field has strengths relative to it.
"""
ROUNDS = 20
"""Number of times that outliers are removed and the slope is fitted again."""
OUTLIER = 3.0
"""Maximum deviation of a track's slope from the fit, in standard deviations.

A track beyond it is left out, because it joins more cells than one.
"""


def _bacteria(slope: float, rng: np.random.Generator) -> Swimmers:
    cells = Swimmers.drawn(rng, CELLS)
    cells.speed[:] = 32 * np.exp(rng.normal(0, 0.2, CELLS))
    cells.helix_um[:] = 0.1
    cells.helix_hz[:] = 2.0
    cells.walk[:] = WALK
    cells.a[:] = slope * np.exp(rng.normal(-(SPREAD**2) / 2, SPREAD, CELLS))  # at 1 mT
    return cells


def _tracked(strength: float, slope: float, rng: np.random.Generator) -> Sequence[CellSummary]:
    """Simulate the tracks of a table in a field that reverses, and fit them as `track` does."""
    times = np.arange(round(REVERSALS * HOLD_S * RATE_HZ)) / RATE_HZ
    angles = rng.uniform(-math.pi, math.pi) + math.pi * (times // HOLD_S)
    cells = _bacteria(slope, rng)
    shown = []
    for angle in angles.tolist():
        now = bodies(cells)
        shown.append(np.column_stack([now.x, now.y]) + rng.normal(0, NOISE_UM, (CELLS, 2)))
        field_mt = (strength * math.cos(angle), strength * math.sin(angle))
        cells.swim(field_mt, 1 / RATE_HZ, rng)
    places = np.array(shown)
    paths = [CellPath(cell, times, places[:, cell]) for cell in range(CELLS)]
    record = FieldRecord(times, angles, np.full(len(times), strength / REFERENCE_MT))
    return fit_tracks(paths, MAGNETOSPIRILLUM, record, 1 / RATE_HZ)


def fitted(slopes: Floats, deviations: Floats) -> tuple[float, float, float]:
    """Fit the slope a / B from the slopes of tracks (T,), with its 95 % interval.

    The result is a line through the origin. Each track is weighted by its own variance plus the
    variance among cells. The interval uses Student's t. Tracks more than OUTLIER deviations away
    are left out.
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


def tables(seed: int, number: int) -> dict[str, Any]:
    """Simulate a set of tables, one for each field strength, with a known slope.

    Returns:
        The slope, and a / B of each track with its standard deviation [rad/(mT s)].
    """
    from scipy import stats  # slow to import

    rng = np.random.default_rng([seed, number])
    put_in = float(rng.uniform(*SLOPES))
    cells = [cell for mt in STRENGTHS_MT for cell in _tracked(mt, put_in, rng)]
    couplings = [cell.a_rad_s for cell in cells if cell.a_rad_s is not None]
    deviations = [(a.high - a.low) / 2 / stats.norm.ppf(0.975) / REFERENCE_MT for a in couplings]
    slopes = [a.value / REFERENCE_MT for a in couplings]
    return {"put in": put_in, "slopes": slopes, "deviations": deviations}


def interval_width(tables_of_set: Mapping[str, Any]) -> float:
    """Return the width of the 95 % interval of the slope from a set of tables [rad/(mT s)]."""
    _, low, high = _fitted_to(tables_of_set)
    return high - low


def misses_slope(tables_of_set: Mapping[str, Any]) -> bool:
    """Check whether the 95 % interval from a set of tables excludes the simulated slope.

    The ends belong to the interval.
    """
    _, low, high = _fitted_to(tables_of_set)
    return not low <= tables_of_set["put in"] <= high


def _fitted_to(tables_of_set: Mapping[str, Any]) -> tuple[float, float, float]:
    return fitted(np.array(tables_of_set["slopes"]), np.array(tables_of_set["deviations"]))


PAPER = Paper(
    source="Pichel and others, 2018: turning rate against the field's strength (simulated "
    "tracks; the slope is put in)",
    arms={"tables": Work(tables)},
    claims=[
        Claim(
            figure="a over B: width of its interval, 204 cells",
            published="0.06 rad/(mT s), of 0.74 +- 0.03",
            arm="tables",
            measure=interval_width,
            unit="rad/(mT s)",
            asked=not_judged(mean_of),
            expected=Fate.NOT_JUDGED,
        ),
        Claim(
            figure="a over B: the slope put in is not in its interval",
            published="in 5 %, as the interval is of 95 %",
            arm="tables",
            measure=misses_slope,
            asked=as_often(0.05),
            expected=Fate.AGREES,
        ),
    ],
)

"""Checks, with simulated bacteria, a measurement by Pichel and others (2018) of how fast they turn.

The paper is "Magnetic response of Magnetospirillum gryphiswaldense" (arXiv 1710.00405). Its authors
measured how fast bacteria turn in fields of 1 to 12 mT, from U-turns in a channel of 5 um. This
module simulates the tracks, one table for each field strength, and fits them as `tetractl track`
does. The slope of the turning rate a against the field strength B is an input, with another value
for each set of tables. The result therefore only shows that the method works.
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
N_CELLS = 34  # in each table
SLOPE_RANGE = 0.5, 1.0
"""Range of the simulated slopes of a against B [rad/(mT s)]. The fit does not know the slope."""
LOG_SLOPE_SD = 0.15
"""Assumed standard deviation, among cells, of the logarithm of the slope."""
HEADING_WALK_SD = 0.1
"""Assumed random walk of a heading: its standard deviation after one second [rad/sqrt(s)]."""
POSITION_SD_UM = 0.1
"""Assumed standard deviation of each coordinate of a tracked position [um]."""
RATE_HZ = 15  # images per second
HOLD_S = 3.0  # time between two reversals of the field [s]
N_REVERSALS = 4
REFERENCE_MT = 4.0
"""The reference field [mT]: the turning rate a is stated for this field strength.

The strengths in a recorded field are relative to it.
"""
N_FIT_ROUNDS = 20
"""Number of times that the fit leaves out outliers and is repeated."""
DEVIATION_MAX = 3.0
"""Maximum deviation of a track's slope from the fit, in standard deviations.

The fit leaves out tracks that deviate more, because such a track usually joins several cells.
"""


def _sample_bacteria(slope: float, rng: np.random.Generator) -> Swimmers:
    """Sample N_CELLS bacteria whose mean turning rate at 1 mT is `slope` [rad/s]."""
    cells = Swimmers.drawn(rng, N_CELLS)
    cells.speed[:] = 32 * np.exp(rng.normal(0, 0.2, N_CELLS))
    cells.helix_um[:] = 0.1
    cells.helix_hz[:] = 2.0
    cells.walk[:] = HEADING_WALK_SD
    cells.a[:] = slope * np.exp(
        rng.normal(-(LOG_SLOPE_SD**2) / 2, LOG_SLOPE_SD, N_CELLS)
    )  # at 1 mT
    return cells


def _simulate_tracks(
    strength_mt: float, slope: float, rng: np.random.Generator
) -> Sequence[CellSummary]:
    """Simulate tracks in a field that reverses every HOLD_S, and fit them as `tetractl track` does.

    Args:
        strength_mt: Strength of the field [mT].
        slope: Mean turning rate of the cells per field strength [rad/(mT s)].
        rng: Generator of all random numbers.
    """
    times = np.arange(round(N_REVERSALS * HOLD_S * RATE_HZ)) / RATE_HZ
    angles = rng.uniform(-math.pi, math.pi) + math.pi * (times // HOLD_S)
    cells = _sample_bacteria(slope, rng)
    measured_places = []
    for angle in angles.tolist():
        cell_bodies = bodies(cells)
        measured_places.append(
            np.column_stack([cell_bodies.x, cell_bodies.y])
            + rng.normal(0, POSITION_SD_UM, (N_CELLS, 2))
        )
        field_mt = (strength_mt * math.cos(angle), strength_mt * math.sin(angle))
        cells.swim(field_mt, 1 / RATE_HZ, rng)
    places = np.array(measured_places)
    paths = [CellPath(cell, times, places[:, cell]) for cell in range(N_CELLS)]
    record = FieldRecord(times, angles, np.full(len(times), strength_mt / REFERENCE_MT))
    return fit_tracks(paths, MAGNETOSPIRILLUM, record, 1 / RATE_HZ)


def fit_slope(slopes: Floats, slope_sds: Floats) -> tuple[float, float, float]:
    """Fit the mean ratio of turning rate to field strength, a / B, from the ratios of many tracks.

    The weight of a track is the inverse of its own variance plus the variance among cells. The
    interval uses Student's t. Tracks that deviate by more than DEVIATION_MAX standard deviations
    are left out.

    Args:
        slopes: a / B of each track, shape (T,) [rad/(mT s)].
        slope_sds: Standard deviations of `slopes`, shape (T,) [rad/(mT s)].

    Returns:
        The mean ratio, and the lower and the upper end of its 95 % interval [rad/(mT s)].
    """
    from scipy import stats  # slow to import

    mean_slope = float(np.median(slopes))
    median_deviation = float(np.median(np.abs(slopes - mean_slope)))
    sd_among_cells = median_deviation / stats.norm.ppf(0.75)
    weights = 1 / (sd_among_cells**2 + slope_sds**2)
    is_near = np.abs(slopes - mean_slope) * np.sqrt(weights) < DEVIATION_MAX
    for _ in range(N_FIT_ROUNDS):
        mean_slope = float(np.average(slopes[is_near], weights=weights[is_near]))
        is_near = np.abs(slopes - mean_slope) * np.sqrt(weights) < DEVIATION_MAX
    weight_fractions = weights[is_near] / weights[is_near].sum()
    standard_error = float(
        np.sqrt(np.sum((weight_fractions * (slopes[is_near] - mean_slope)) ** 2))
    )
    half_width = float(stats.t.ppf(0.975, is_near.sum() - 1)) * standard_error
    return mean_slope, mean_slope - half_width, mean_slope + half_width


def simulate_tables(seed: int, number: int) -> dict[str, Any]:
    """Simulate a set of tables, one for each field strength, with a known slope of a against B.

    Args:
        seed: Root seed of the random numbers.
        number: Index of the set, from 0.

    Returns:
        "put in" maps to the true slope, "slopes" to a / B of each track, and "deviations" to the
        standard deviations of these ratios, all in rad/(mT s).
    """
    from scipy import stats  # slow to import

    rng = np.random.default_rng([seed, number])
    true_slope = float(rng.uniform(*SLOPE_RANGE))
    cells = [
        cell
        for strength_mt in STRENGTHS_MT
        for cell in _simulate_tracks(strength_mt, true_slope, rng)
    ]
    couplings = [cell.a_rad_s for cell in cells if cell.a_rad_s is not None]
    slope_sds = [(a.high - a.low) / 2 / stats.norm.ppf(0.975) / REFERENCE_MT for a in couplings]
    slopes = [a.value / REFERENCE_MT for a in couplings]
    return {"put in": true_slope, "slopes": slopes, "deviations": slope_sds}


def interval_width(tables_of_set: Mapping[str, Any]) -> float:
    """Compute the width of the 95 % interval of a / B from a set of tables [rad/(mT s)]."""
    _, low, high = _fit_tables(tables_of_set)
    return high - low


def misses_slope(tables_of_set: Mapping[str, Any]) -> bool:
    """Check whether the 95 % interval of a / B from a set of tables excludes the true slope.

    The ends belong to the interval.
    """
    _, low, high = _fit_tables(tables_of_set)
    return not low <= tables_of_set["put in"] <= high


def _fit_tables(tables_of_set: Mapping[str, Any]) -> tuple[float, float, float]:
    """Fit a / B to a set of tables: the mean ratio and its 95 % interval [rad/(mT s)]."""
    return fit_slope(np.array(tables_of_set["slopes"]), np.array(tables_of_set["deviations"]))


PAPER = Paper(
    source="Pichel and others, 2018: turning rate against the field's strength (simulated "
    "tracks; the slope is put in)",
    arms={"tables": Work(simulate_tables)},
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

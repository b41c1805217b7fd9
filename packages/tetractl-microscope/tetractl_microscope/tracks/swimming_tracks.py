"""Selects the tracks of swimming cells in a table of another program, and describes them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path

import numpy as np

from tetractl.core.errors import TetractlError, UsageError
from tetractl.tools.table.table_files import convert_to_plain
from tetractl_microscope.cells.field_record import FieldRecord
from tetractl_microscope.organisms import Organism
from tetractl_microscope.registries import ORGANISMS
from tetractl_microscope.tracks.fit_track import IMAGE_RATE_MIN_HZ, CellPath, fit_tracks
from tetractl_microscope.tracks.foreign_tracks import SpotTrack
from tetractl_microscope.tracks.onward import (
    TO_AND_FRO,
    hardly_any_keeps_direction,
    track_keeps_direction,
)

SHORTEST_S = 2.0
"""Minimum duration of a track of which a speed is stated [s]."""
COURSE_S = 0.3
"""Time over which a direction of motion is known [s]: less is a part of a turn of the helix."""
TOGETHER = 3.0
"""Minimum ratio of the cells' common velocity to each cell's own velocity at which a stage moves.

Eight cells that swim in independent directions reached it in 22 of 10,000 samples.
"""
TOGETHER_MIN = 8
"""Minimum number of cells for that finding."""
STRAIGHT = 0.7
TURNS_ABOUT = 0.5
"""Maximum length of the mean of a field's unit vectors, for a field that turns about.

`STRAIGHT` is the minimum net displacement of cells that a flow carries, as a fraction of their
path.
"""
STRAIGHTER = 0.9
"""Minimum ratio of the upper limit of a cell's speed along its helix to its VSL.

Below it, the cell turns by itself, and the fit of the helix is not valid.
"""
OF_THE_HELIX = (
    "speed_um_s",
    "speed_sd_um_s",
    "path_um",
    "sway_rad",
    "helix_hz",
    "helix_um",
    "a_rad_s",
    "bias_rad",
    "magnetised",
)
"""Values that are set to None for a cell that turns by itself."""
SPEED_S = 1.0
"""Time over which speeds are measured, to choose the organism with the most similar speed [s]."""


@dataclass(frozen=True, slots=True)
class CellTracks:
    """The tracks of swimming cells in a table of another program.

    Attributes:
        paths: The tracks.
        period_s: Usual time between two images [s].
        span_s: Times of the first and of the last image [s].
        remarks: Lines for the user about the tracks that are left out.
    """

    paths: tuple[CellPath, ...]
    period_s: float
    span_s: tuple[float, float]
    remarks: tuple[str, ...]


def swimming_tracks(source: Path, tracks: Sequence[SpotTrack], with_field: bool) -> CellTracks:
    """Select the tracks of swimming cells from tracks that are seen for SHORTEST_S.

    Args:
        source: The file of the tracks.
        tracks: All tracks.
        with_field: Whether the field is known.

    Raises:
        UsageError: If there is none, or, with a field, if images are too rare.
        TetractlError: If hardly any cell keeps its direction.
    """
    long_tracks = [track for track in tracks if np.ptp(track.rows[:, 0]) >= SHORTEST_S]
    brief = [f"{track.number:.0f}" for track in tracks if np.ptp(track.rows[:, 0]) < SHORTEST_S]
    if not long_tracks:
        raise UsageError(f"{source}: no cell was seen for {SHORTEST_S:g} s")
    remarks = list[str]()
    if brief:
        remarks.append(
            f"left out, because they were seen for less than {SHORTEST_S:g} s: {_cells(brief)}"
        )
    gaps_s = np.concatenate([np.diff(track.rows[:, 0]) for track in long_tracks])
    period_s = float(np.median(gaps_s))
    if with_field and period_s * IMAGE_RATE_MIN_HZ > 1:
        raise UsageError(
            f"{source}: images are {period_s:.3g} s apart, which is too long, because a heading "
            f"is the direction of motion over {COURSE_S:g} s",
            f"film at {math.ceil(IMAGE_RATE_MIN_HZ)} images/s or more; if the times are in ms, "
            "name their column time_ms",
        )
    going_on = [track_keeps_direction(track.rows[:, 0], track.rows[:, 1:]) for track in long_tracks]
    if hardly_any_keeps_direction(going_on):
        raise TetractlError(
            f"{source}: {TO_AND_FRO}",
            "give tracks of swimming cells: a swimming cell moves "
            "on, and does not return to its place within seconds",
        )
    to_and_fro = [
        f"{track.number:.0f}"
        for track, goes_on in zip(long_tracks, going_on, strict=True)
        if not goes_on
    ]
    if to_and_fro:
        remarks.append(
            f"warning: left out, because they go back and forth, as beads do: {_cells(to_and_fro)}"
        )
    swimming = compress(long_tracks, going_on)
    paths = tuple(
        CellPath(round(track.number), track.rows[:, 0], track.rows[:, 1:]) for track in swimming
    )
    first_s = min(float(track.rows[0, 0]) for track in long_tracks)
    last_s = max(float(track.rows[-1, 0]) for track in long_tracks)
    return CellTracks(paths, period_s, (first_s, last_s), tuple(remarks))


def stage_remarks(paths: Sequence[CellPath], field: FieldRecord | None = None) -> tuple[str, ...]:
    """Return a warning if all cells move together, as objects do on a moving stage.

    Without a field, each cell swims in its own direction, so the mean of their velocities is small.
    In a field that turns, cells move together, but never to one side for long.
    """
    velocities = np.array(
        [(p.places[-1] - p.places[0]) / (p.times[-1] - p.times[0]) for p in paths]
    )
    if len(velocities) < TOGETHER_MIN:
        return ()
    common = np.median(velocities, axis=0)
    speed_um_s = float(np.hypot(*common))
    own_um_s = float(np.median(np.linalg.norm(velocities - common, axis=1)))
    if speed_um_s < TOGETHER * own_um_s:
        return ()
    if field is not None:
        pace_um_s = float(np.median([_speed_um_s(path) for path in paths]))
        straight = speed_um_s / pace_um_s
        times = np.unique(np.concatenate([path.times for path in paths]))
        to_a_side = abs(np.mean(np.sign(field.at(times))))
        if straight < STRAIGHT or to_a_side > TURNS_ABOUT:
            return ()
    of_field = "" if field is None else ", and no a is fitted"
    return (
        (
            f"warning: all cells move together at {speed_um_s:.0f} um/s, in addition to "
            f"{own_um_s:.0f} um/s of their own: does the stage move, or does the medium flow? "
            "Their speeds include this common motion"
        )
        + of_field,
    )


def _cells(names: Sequence[str]) -> str:
    return ", ".join(f"cell {name}" for name in names)


def organism_by_speed(paths: Sequence[CellPath]) -> Organism:
    """Find the organism whose speed is most similar to the median speed of the cells.

    Speeds are compared by their logarithms, with the middle of each organism's range.
    """
    speed_um_s = float(np.median([_speed_um_s(path) for path in paths]))
    log_speed = math.log(speed_um_s)

    def unlike(kind: Organism) -> float:
        return abs(log_speed - math.log(math.prod(kind.speed_um_s)) / 2)

    return min(ORGANISMS.load_usable().values(), key=unlike)


def _speed_um_s(path: CellPath) -> float:
    """Return the median speed of a cell over SPEED_S seconds, or its whole path if that is shorter.

    The path needs at least two images. The speed is in um/s and never 0.
    """
    step_s = float(np.median(np.diff(path.times)))
    steps = max(1, round(SPEED_S / step_s))
    steps = min(steps, len(path.times) - 1)
    ways = np.linalg.norm(path.places[steps:] - path.places[:-steps], axis=1)
    return max(float(np.median(ways / (path.times[steps:] - path.times[:-steps]))), 1e-9)


def track_record(
    source: Path, cells: CellTracks, organism: Organism, field: FieldRecord | None
) -> dict:
    """Return the record that `tetractl track --json` prints.

    Args:
        source: The table of tracks.
        cells: Its tracks of swimming cells.
        organism: What swims.
        field: The field over time. None if there was none.
    """
    summaries = fit_tracks(cells.paths, organism, field, cells.period_s)
    note = f"the cells are tracked as {organism.name}; choose another organism with --organism"
    if 1 / cells.period_s < IMAGE_RATE_MIN_HZ:
        note = (
            f"with fewer than {math.ceil(IMAGE_RATE_MIN_HZ)} images/s, the speed of cells along "
            "their helix cannot be measured"
        )
    notes = [note]
    items = [cell.items() for cell in summaries]
    turning: list[str] = []
    for item in items:
        speed = item["speed_um_s"]
        # along a helix it is below the velocity along its way
        if speed is not None and speed["ci95"][1] < STRAIGHTER * item["vsl_um_s"]:
            item.update(dict.fromkeys(OF_THE_HELIX))
            turning.append(str(item["cell"]))
    if turning:
        names = _cells(turning)
        notes.append(
            "cells without a speed and an a, because they turn by themselves in a way"
            f" that no helix explains: {names}"
        )
    return convert_to_plain(
        {
            "tracks": source.name,
            "rate_hz": 1 / cells.period_s,
            "organism": organism.name,
            "cells": items,
            "notes": notes,
            "field": None if field is None else field.items(),
        }
    )

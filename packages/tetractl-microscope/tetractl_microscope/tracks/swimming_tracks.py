"""Selects the tracks of swimming cells from a table of another program, and measures the cells."""

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

TRACK_DURATION_MIN_S = 2.0
"""Minimum duration of a track [s]. The speed of a shorter track is not estimated."""
COURSE_S = 0.3
"""Time over which a direction of motion is measured [s].

Over less time, it would only be the direction of a part of the helix along which a cell swims.
"""
COMMON_MOTION_RATIO_MIN = 3.0
"""Minimum ratio of the cells' common speed to their own speeds at which a moving stage is reported.

Eight cells that swim in independent directions reached it in 22 of 10,000 samples.
"""
STAGE_CELLS_MIN = 8
"""Minimum number of cells for a report that the stage moves."""
FLOW_STRAIGHTNESS_MIN = 0.7
"""Minimum ratio of the cells' common speed to their speed along the path, if a flow carries them.

Cells that follow a field change direction with it, so their ratio is lower.
"""
MEAN_FIELD_MAX = 0.5
"""Maximum length of the mean of the field's unit vectors at which the field turns enough.

If the field mostly points to one side, cells move together because they follow it. Their common
motion then does not show that the stage moves.
"""
HELIX_SPEED_RATIO_MIN = 0.9
"""Minimum ratio of the upper limit of a cell's speed along its helix to its straight-line velocity.

Below it, the cell turns by itself, and the fit of the helix is not valid.
"""
HELIX_KEYS = (
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
"""Keys of the values that are set to None for a cell that turns by itself."""
SPEED_WINDOW_S = 1.0
"""Time over which a cell's speed is measured, to find the most similar organism [s]."""


@dataclass(frozen=True, slots=True)
class CellTracks:
    """The tracks of swimming cells, selected from a table of another program.

    Attributes:
        paths: The tracks of the swimming cells.
        period_s: Median time between two images [s].
        span_s: Times of the first and of the last image [s].
        remarks: Messages for the user about tracks that were left out.
    """

    paths: tuple[CellPath, ...]
    period_s: float
    span_s: tuple[float, float]
    remarks: tuple[str, ...]


def select_swimming_tracks(
    source: Path, tracks: Sequence[SpotTrack], with_field: bool
) -> CellTracks:
    """Select the tracks of swimming cells, and leave out short tracks and those of drifting beads.

    A track is short if it lasts less than TRACK_DURATION_MIN_S. A swimming cell keeps its
    direction, while a bead goes back and forth.

    Args:
        source: The file of the tracks, for messages.
        tracks: All tracks.
        with_field: Whether the field is known. The images must then be frequent enough to show the
            cells' headings.

    Raises:
        UsageError: If every track is short, or if images are too rare for a known field.
        TetractlError: If hardly any cell keeps its direction.
    """
    long_tracks = [track for track in tracks if np.ptp(track.rows[:, 0]) >= TRACK_DURATION_MIN_S]
    short_names = [
        f"{track.number:.0f}" for track in tracks if np.ptp(track.rows[:, 0]) < TRACK_DURATION_MIN_S
    ]
    if not long_tracks:
        raise UsageError(f"{source}: no cell was seen for {TRACK_DURATION_MIN_S:g} s")
    remarks = list[str]()
    if short_names:
        remarks.append(
            f"left out, because they were seen for less than {TRACK_DURATION_MIN_S:g} s: "
            f"{_list_cells(short_names)}"
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
    keeps_direction = [
        track_keeps_direction(track.rows[:, 0], track.rows[:, 1:]) for track in long_tracks
    ]
    if hardly_any_keeps_direction(keeps_direction):
        raise TetractlError(
            f"{source}: {TO_AND_FRO}",
            "give tracks of swimming cells: a swimming cell moves "
            "on, and does not return to its place within seconds",
        )
    bead_names = [
        f"{track.number:.0f}"
        for track, keeps_on in zip(long_tracks, keeps_direction, strict=True)
        if not keeps_on
    ]
    if bead_names:
        remarks.append(
            "warning: left out, because they go back and forth, as beads do: "
            f"{_list_cells(bead_names)}"
        )
    swimmers = compress(long_tracks, keeps_direction)
    paths = tuple(
        CellPath(round(track.number), track.rows[:, 0], track.rows[:, 1:]) for track in swimmers
    )
    first_s = min(float(track.rows[0, 0]) for track in long_tracks)
    last_s = max(float(track.rows[-1, 0]) for track in long_tracks)
    return CellTracks(paths, period_s, (first_s, last_s), tuple(remarks))


def describe_moving_stage(
    paths: Sequence[CellPath], field: FieldRecord | None = None
) -> tuple[str, ...]:
    """Warn if all cells move together, as objects do on a moving stage or in a flow.

    Without a field, each cell swims in its own direction, so the mean of their velocities is small.
    In a field that turns, cells move together, but never to one side for long.

    Args:
        paths: The tracks of the cells.
        field: The field over time. None if it is unknown.

    Returns:
        One warning, or none.
    """
    velocities = np.array(
        [(path.places[-1] - path.places[0]) / (path.times[-1] - path.times[0]) for path in paths]
    )
    if len(velocities) < STAGE_CELLS_MIN:
        return ()
    common_velocity = np.median(velocities, axis=0)
    common_speed_um_s = float(np.hypot(*common_velocity))
    own_speed_um_s = float(np.median(np.linalg.norm(velocities - common_velocity, axis=1)))
    if common_speed_um_s < COMMON_MOTION_RATIO_MIN * own_speed_um_s:
        return ()
    if field is not None:
        swimming_speed_um_s = float(np.median([_speed_um_s(path) for path in paths]))
        straightness = common_speed_um_s / swimming_speed_um_s
        times = np.unique(np.concatenate([path.times for path in paths]))
        mean_field = abs(np.mean(np.sign(field.field_at(times))))
        if straightness < FLOW_STRAIGHTNESS_MIN or mean_field > MEAN_FIELD_MAX:
            return ()
    fit_note = "" if field is None else ", and no turning rate a is fitted"
    return (
        (
            f"warning: all cells move together at {common_speed_um_s:.0f} um/s, while each swims "
            f"at {own_speed_um_s:.0f} um/s: does the stage move, or does the medium flow? The "
            "speeds below include this common motion"
        )
        + fit_note,
    )


def _list_cells(names: Sequence[str]) -> str:
    """Format a list of cells, such as "cell 3, cell 7"."""
    return ", ".join(f"cell {name}" for name in names)


def find_organism_by_speed(paths: Sequence[CellPath]) -> Organism:
    """Find the organism whose usual speed is most similar to the median speed of some cells.

    The logarithm of the median speed is compared with the middle of each organism's range of
    logarithmic speeds.
    """
    speed_um_s = float(np.median([_speed_um_s(path) for path in paths]))
    log_speed = math.log(speed_um_s)

    def log_speed_difference(kind: Organism) -> float:
        return abs(log_speed - math.log(math.prod(kind.speed_um_s)) / 2)

    return min(ORGANISMS.load_usable().values(), key=log_speed_difference)


def _speed_um_s(path: CellPath) -> float:
    """Compute a cell's median speed over windows of SPEED_WINDOW_S [um/s]. It is never 0.

    If the track is shorter than the window, the speed is measured over the whole track. The track
    needs at least two images.
    """
    step_s = float(np.median(np.diff(path.times)))
    n_steps = max(1, round(SPEED_WINDOW_S / step_s))
    n_steps = min(n_steps, len(path.times) - 1)
    distances_um = np.linalg.norm(path.places[n_steps:] - path.places[:-n_steps], axis=1)
    return max(
        float(np.median(distances_um / (path.times[n_steps:] - path.times[:-n_steps]))), 1e-9
    )


def create_track_record(
    source: Path, cells: CellTracks, organism: Organism, field: FieldRecord | None
) -> dict:
    """Estimate each cell's speed and response, and create the record for `tetractl track --json`.

    Args:
        source: The table of tracks. The record contains its name.
        cells: The tracks of the swimming cells.
        organism: The organism that swims.
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
    cell_items = [cell.items() for cell in summaries]
    turning_names: list[str] = []
    for cell_item in cell_items:
        speed = cell_item["speed_um_s"]
        # the speed along the axis of a helix is at least the straight-line velocity
        if speed is not None and speed["ci95"][1] < HELIX_SPEED_RATIO_MIN * cell_item["vsl_um_s"]:
            cell_item.update(dict.fromkeys(HELIX_KEYS))
            turning_names.append(str(cell_item["cell"]))
    if turning_names:
        listed_names = _list_cells(turning_names)
        notes.append(
            "no speed and no turning rate a are given for these cells, because they turn in a way "
            f"that no helix explains: {listed_names}"
        )
    return convert_to_plain(
        {
            "tracks": source.name,
            "rate_hz": 1 / cells.period_s,
            "organism": organism.name,
            "cells": cell_items,
            "notes": notes,
            "field": None if field is None else field.items(),
        }
    )

"""Tracks from CSV files: tracked poses in one, commands in another, as `tetractl export` writes."""

import math
import re
from pathlib import Path

import numpy as np

from tetractl.core.errors import UsageError
from tetractl.core.poses import Bools
from tetractl.core.table.table_files import read_csv
from tetractl.replay.identification.tracks import Track

ORIGIN = "CSV"
POSES = ("time_s", "robot", "heading_rad")
COMMANDS = ("time_s", "direction_rad")
_POSITION = re.compile(r"x_(um|mm|cm|m)$")

Row = dict[str, str]
Trial = tuple[str, str]


def csv_tracks(paths: list[Path]) -> list[Track]:
    """Return the tracks in some CSV files, of which each holds poses or commands.

    Poses are rows of time_s, robot, x_UNIT, y_UNIT, heading_rad and perhaps valid; commands of
    time_s, direction_rad and perhaps observed_s. If there are columns log and trial, poses and
    commands of the same belong together; else all do. UsageError names what is missing.
    """
    poses: dict[Trial, list[Row]] = {}
    commands: dict[Trial, list[Row]] = {}
    unit, named = "", {}
    for path in paths:
        rows = list(read_csv(path))
        columns = rows[0].keys() if rows else ()
        if all(name in columns for name in COMMANDS):
            into = commands
        elif all(name in columns for name in POSES):
            into = poses
            found = next((m[1] for name in columns if (m := _POSITION.match(name))), None)
            if found is None or (unit and unit != found):
                raise UsageError(f"{path}: needs x_mm and y_mm, or another unit throughout")
            unit = found
        else:
            raise UsageError(
                f"{path}: holds neither poses nor commands",
                f"poses have the columns {', '.join(POSES)}, x_mm, y_mm; commands "
                f"{' and '.join(COMMANDS)}",
            )
        for row in rows:
            trial = row.get("log", ""), row.get("trial", "")
            into.setdefault(trial, []).append(row)
            named.setdefault(trial, path)
    lonely = sorted(poses.keys() ^ commands.keys())
    if lonely or not poses:
        which = f"{named[lonely[0]]}: " if lonely else ""
        raise UsageError(
            f"{which}poses and commands are needed of each trial",
            "name both files, such as poses.csv steps.csv of `tetractl export`",
        )
    return [_track(poses[trial], commands[trial], unit, named[trial], trial) for trial in poses]


def _track(poses: list[Row], commands: list[Row], unit: str, path: Path, trial: Trial) -> Track:
    names = tuple(dict.fromkeys(row["robot"] for row in poses))
    time = np.unique([_number(row, "time_s", path) for row in poses])
    found = np.full((len(time), len(names), 3), np.nan)
    for row in poses:
        i = int(np.searchsorted(time, _number(row, "time_s", path)))
        if row.get("valid", "True").strip().lower() in ("true", "1", ""):
            keys = (f"x_{unit}", f"y_{unit}", "heading_rad")
            found[i, names.index(row["robot"])] = [_number(row, key, path, True) for key in keys]
    valid: Bools = ~np.isnan(found[..., 0] + found[..., 1] + found[..., 2])
    sent = np.array([_number(row, "time_s", path) for row in commands])
    order = np.argsort(sent, kind="stable")
    sent = sent[order]
    u = np.array([_number(row, "direction_rad", path) for row in commands])[order]
    gap = float(np.median(np.diff(sent))) if len(sent) > 1 else 0.0
    label = trial[0] or str(path)
    observed = [_number(row, "observed_s", path, True) for row in commands][1:]
    ages = [t - o for t, o in zip(sent[1:], observed, strict=True) if math.isfinite(o)]
    return Track(
        source=label,
        origin=ORIGIN,
        unit=unit,
        names=names,
        time=time,
        poses=np.where(valid[..., None], found, 0.0),
        valid=valid,
        sent=sent,
        u=u,
        until=float(sent[-1]) + gap,
        frame_age=max(0.0, float(np.median(ages))) if ages else None,
    )


def _number(row: Row, column: str, path: Path, optional: bool = False) -> float:
    """Return a number; NaN for one that is `optional` and not there."""
    text = row.get(column, "").strip()
    if not text and optional:
        return math.nan
    try:
        return float(text)
    except ValueError:
        raise UsageError(f"{path}: {column}: {text!r} is not a number") from None

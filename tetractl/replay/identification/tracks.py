"""The data of identification: tracked poses of robots and the directions sent to them, from logs or
from the CSV files of `tetractl export`, poses in one file and commands in another.
"""

import math
import re
from array import array
from collections.abc import Collection
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tetractl.core.clock import SECOND
from tetractl.core.errors import UsageError
from tetractl.core.poses import Bools, Floats, wrap
from tetractl.core.table.table_files import read_csv
from tetractl.log.read.trial_log import TrialLog
from tetractl.log.read.validate import LENGTH_MAX

SHORTEST_S = 0.035  # shortest interval: a frame that follows sooner is left out
DRIVING = 0.5  # a robot drives if it travels at least this fraction of its usual distance
SETTLED_S = 0.5  # time from the first direction after a pause until all robots drive again
PIECES_MAX = 10_000_000  # largest number of intervals times directions in one interval
APART_S = 1000.0  # time between two tracks that are joined


@dataclass(frozen=True, slots=True)
class Track:
    """One trial of N robots: M camera frames and C commands, times in seconds of one clock.

    `time` (M,) is when each frame was exposed, `poses` (M, N, 3) are x, y [length unit] and heading
    [rad], `valid` (M, N) is False if a robot was not tracked. `sent` (C,) is when each command was
    sent and `u` (C,) its direction [rad]. Data after `until` [s], when the robots receive a stop,
    are not used. `frame_age` is the median time [s] from a frame's exposure to the sending of the
    command decided on it, None if unknown.
    """

    source: str
    origin: str
    unit: str
    names: tuple[str, ...]
    time: Floats
    poses: Floats
    valid: Bools
    sent: Floats
    u: Floats
    until: float
    frame_age: float | None = None


class Intervals(NamedTuple):
    """K intervals between two camera frames of N robots.

    An interval lasts from `since` to `until` (K,) [s]. `heading` (K, N) [rad] is the heading at the
    interval's start, `turned` (K, N) [rad] the turn and `travelled` (K, N) [length unit] the
    distance during the interval. `usable` (K, N) is False for a robot that was not tracked, or did
    not move yet.
    """

    since: Floats
    until: Floats
    heading: Floats
    turned: Floats
    travelled: Floats
    usable: Bools


class Directions(NamedTuple):
    """C directions u (C,) [rad], and the times `when` (C,) [s] at which they were sent."""

    when: Floats
    u: Floats


@dataclass(frozen=True, slots=True)
class Drives:
    """Tracks of N robots joined into one, with APART_S between two tracks: K intervals between
    frames.

    `moved` (K, N, 2) is the displacement of an interval [length unit]. `after` (K,) is True if an
    interval begins with the last frame of the interval before.
    """

    intervals: Intervals
    directions: Directions
    moved: Floats
    after: Bools

    @property
    def seconds(self) -> Floats:
        """The length of each interval [s], (K,)."""
        return self.intervals.until - self.intervals.since


def track_of(log: TrialLog) -> Track:
    """Return the track of a log: measured poses and commands, never the true poses."""
    require_field(log)
    setup = log.start.setup
    sent = [one for one in log.commands if one.direction is not None]
    if not sent and log.steps:
        sent = [step.command for step in log.steps]
    ages = [s.command.sent_ns - s.observation.sampled_ns for s in log.steps[1:]]
    last = stopped_ns(log)
    last = max((one.sent_ns for one in sent), default=0) if last is None else last
    return Track(
        source=log.path,
        origin=log.origin.value,
        unit=setup.unit,
        names=setup.names,
        time=log.mocap_ns / SECOND,
        poses=log.mocap,
        valid=log.valid & ~_paused(log)[:, None],
        sent=np.array([one.sent_ns for one in sent], dtype=float) / SECOND,
        u=np.array([one.direction for one in sent], dtype=float),
        until=last / SECOND,
        frame_age=float(np.median(ages)) / SECOND if ages else None,
    )


def _paused(log: TrialLog) -> Bools:
    """Return which frames (M,) were exposed between a stop and SETTLED_S after the next direction:
    the robots stop, stand still, or start to drive.
    """
    sent = [one.sent_ns for one in log.commands if one.direction is not None]
    found = np.zeros(len(log.mocap_ns), dtype=np.bool_)
    for stop in (one.sent_ns for one in log.commands if one.stops):
        again = min((one for one in sent if one > stop), default=None)
        if again is not None:
            until = again + round(SETTLED_S * SECOND)
            found |= (log.mocap_ns >= stop) & (log.mocap_ns < until)
    return found


def require_field(log: TrialLog) -> None:
    """Raise UsageError for a log whose robots drove with the field off at times."""
    if any(one.field_off for one in log.commands):
        raise UsageError(
            f"{log.path}: its robots drove with the field off at times",
            "use the log of a controller that sends a direction at every step",
        )


def stopped_ns(log: TrialLog) -> int | None:
    """Return when the first stop after the last direction was sent [ns], None if that is not known.

    A lab sends several stops at the end; `log.stop` is the last of them.
    """
    last = max((one.sent_ns for one in log.commands if one.direction is not None), default=-1)
    stops = [one.sent_ns for one in log.commands if one.direction is None and one.sent_ns > last]
    return min(stops, default=log.stop.sent_ns if log.stop else None)


def drives_of(tracks: list[Track]) -> Drives:
    """Return several tracks of the same robots as one; UsageError if robots or units differ."""
    first = tracks[0]
    for other in tracks[1:]:
        if (other.names, other.unit) != (first.names, first.unit):
            raise UsageError(
                f"{other.source}: robots or length unit differ from those of {first.source}",
                "identify them separately",
            )
    parts = [_drive(track, APART_S * (i + 1)) for i, track in enumerate(tracks)]
    intervals = Intervals(
        *(
            np.concatenate([getattr(one.intervals, name) for one in parts])
            for name in Intervals._fields
        )
    )
    directions = Directions(
        np.concatenate([one.directions.when for one in parts]),
        np.concatenate([one.directions.u for one in parts]),
    )
    moved = np.concatenate([one.moved for one in parts])
    return Drives(intervals, directions, moved, np.concatenate([one.after for one in parts]))


def _drive(track: Track, begin: float) -> Drives:
    """Return one track as `Drives`, with its times shifted so that the first command is sent at
    `begin` [s].
    """
    if not len(track.sent):
        raise UsageError(f"{track.source}: no direction was sent")
    origin = float(track.sent[0])
    kept = _thinned(track.time)
    time, poses, valid = track.time[kept], track.poses[kept], track.valid[kept]
    moved = np.diff(poses[..., :2], axis=0)
    travelled = np.hypot(moved[..., 0], moved[..., 1])
    seen = valid[:-1] & valid[1:]
    t = np.diff(time)[:, None]
    told = (time[:-1] >= origin) & (time[1:] <= track.until)
    pace = np.divide(travelled, t, out=np.zeros_like(travelled), where=t > 0)
    usual = np.array(
        [np.median(pace[told & seen[:, i], i]) if (told & seen[:, i]).any() else np.inf
         for i in range(len(track.names))]
    )  # fmt: skip
    driving = np.logical_or.accumulate(seen & (pace >= DRIVING * usual) & told[:, None], axis=0)
    began = np.vstack([np.zeros((1, len(track.names)), dtype=np.bool_), driving[:-1]])
    usable = seen & began & told[:, None]
    some = usable.any(axis=1)
    index = np.flatnonzero(some)
    changes = np.append(True, np.diff(track.u) != 0)  # repeated directions are left out
    return Drives(
        Intervals(
            since=time[:-1][some] - origin + begin,
            until=time[1:][some] - origin + begin,
            heading=poses[:-1, :, 2][some],
            turned=wrap(np.diff(poses[..., 2], axis=0))[some],
            travelled=travelled[some],
            usable=usable[some],
        ),
        Directions(track.sent[changes] - origin + begin, track.u[changes]),
        moved=moved[some],
        after=np.diff(index, prepend=-2) == 1,
    )


def _thinned(time: Floats) -> list[int]:
    """Return the indices of frames of a track that are at least SHORTEST_S apart."""
    kept: list[int] = []
    for i, t in enumerate(time):
        if not kept or t - time[kept[-1]] >= SHORTEST_S - 1e-9:
            kept.append(i)
    return kept


def substeps(
    intervals: Intervals, when: Floats, tau: float
) -> list[tuple[NDArray[np.int64], Floats]]:
    """Return which of the directions sent at `when` (C,) [s] act in each interval: a pair of arrays
    for the oldest direction in each interval, a pair for the next, and so on.

    A pair holds the directions' indices (K,) and the times (K,) for which they act [s], 0 if an
    interval has fewer directions. A direction acts from `tau` [s] after it was sent; the first
    direction also acts before that.
    """
    acts = when + tau
    ends = np.append(acts[1:], np.inf)  # the last direction acts until the end
    first = np.maximum(acts.searchsorted(intervals.since, "right") - 1, 0)
    last = acts.searchsorted(intervals.until, "left") - 1
    found, begin = [], intervals.since
    pieces = int((last - first).max(initial=0)) + 1
    if pieces * len(first) > PIECES_MAX:
        raise UsageError(f"{pieces} directions were sent between two frames", "log more frames")
    for piece in range(pieces):
        number = np.minimum(first + piece, len(when) - 1)
        end = np.minimum(ends[number], intervals.until)
        found.append((number, np.maximum(end - begin, 0.0)))
        begin = np.maximum(begin, end)
    return found


ORIGIN = "CSV"
POSES = ("time_s", "robot", "heading_rad")
COMMANDS = ("time_s", "direction_rad")
_POSITION = re.compile(r"x_(um|mm|cm|m)$")

ROBOTS_MAX, TRIALS_MAX, POSES_MAX = 1000, 10_000, 2_000_000
"""Largest numbers of robots and trials in CSV files, and of robots times frames in a trial."""

Row = dict[str, str]
Trial = tuple[str, str]


@dataclass(slots=True)
class _Numbers:
    """The numbers of a trial in CSV files: time, robot, x, y and heading of each pose; time,
    direction and time of observation of each command. NaN is an unknown number.
    """

    path: Path
    robots: dict[str, int] = field(default_factory=dict)
    poses: "array[float]" = field(default_factory=lambda: array("d"))
    commands: "array[float]" = field(default_factory=lambda: array("d"))


def csv_tracks(paths: list[Path]) -> list[Track]:
    """Return the tracks in some CSV files, each of poses or of commands.

    Poses are rows of time_s, robot, x_UNIT, y_UNIT, heading_rad and perhaps valid; commands of
    time_s, direction_rad and perhaps observed_s. Columns log and trial, if present, assign poses
    and commands to tracks. Raises UsageError if data are missing, or very many.
    """
    trials: dict[Trial, _Numbers] = {}
    unit = ""
    for path in paths:
        rows = read_csv(path)
        first = next(rows, {})
        commands = all(name in first for name in COMMANDS)
        if not commands:
            unit = _unit(first, unit, path)
        for row in chain([first], rows):
            trial = row.get("log", ""), row.get("trial", "")
            one = trials.setdefault(trial, _Numbers(path))
            if commands:
                one.commands.extend(_number(row, column, path) for column in COMMANDS)
                one.commands.append(_number(row, "observed_s", path, True))
            else:
                known = row.get("valid", "True").strip().lower() in ("true", "1", "")
                keys = (f"x_{unit}", f"y_{unit}", "heading_rad")
                robot = one.robots.setdefault(row["robot"], len(one.robots))
                one.poses.extend((_number(row, "time_s", path), robot))
                one.poses.extend(_number(row, k, path, True) if known else math.nan for k in keys)
            if len(one.robots) > ROBOTS_MAX or len(trials) > TRIALS_MAX:
                raise UsageError(
                    f"{path}: has more than {ROBOTS_MAX} robots or {TRIALS_MAX} trials"
                )
    lonely = sorted(trial for trial, one in trials.items() if not (one.poses and one.commands))
    if lonely:
        raise UsageError(
            f"{trials[lonely[0]].path}: both poses and commands are needed for each trial",
            "name both files, such as poses.csv steps.csv of `tetractl export`",
        )
    return [_track(one, unit, trial) for trial, one in trials.items()]


def _unit(columns: Collection[str], unit: str, path: Path) -> str:
    """Return the length unit of a file of poses by its columns, which must be the given one."""
    if not all(name in columns for name in POSES):
        raise UsageError(
            f"{path}: contains neither poses nor commands",
            f"poses have the columns {', '.join(POSES)}, x_mm, y_mm; commands "
            f"{' and '.join(COMMANDS)}",
        )
    found = next((m[1] for name in columns if (m := _POSITION.match(name))), None)
    if found is None or (unit and unit != found):
        raise UsageError(f"{path}: needs columns x_mm and y_mm, or both with another unit")
    return found


def _track(trial: _Numbers, unit: str, name: Trial) -> Track:
    rows = np.array(trial.poses).reshape(-1, 5)
    time, frame = np.unique(rows[:, 0], return_inverse=True)
    if len(time) * len(trial.robots) > POSES_MAX:
        what = f"{len(trial.robots)} robots at {len(time)} times"
        raise UsageError(f"{trial.path}: has {what}; at most {POSES_MAX} poses are read of a trial")
    found = np.full((len(time), len(trial.robots), 3), np.nan)
    found[frame, rows[:, 1].astype(int)] = rows[:, 2:]
    valid: Bools = ~np.isnan(found[..., 0] + found[..., 1] + found[..., 2])
    commands = np.array(trial.commands).reshape(-1, 3)
    ages = (commands[:, 0] - commands[:, 2])[1:]
    ages = ages[np.isfinite(ages)]
    sent, u, _ = commands[np.argsort(commands[:, 0], kind="stable")].T
    gap = float(np.median(np.diff(sent))) if len(sent) > 1 else 0.0
    return Track(
        source=name[0] or str(trial.path),
        origin=ORIGIN,
        unit=unit,
        names=tuple(trial.robots),
        time=time,
        poses=np.where(valid[..., None], found, 0.0),
        valid=valid,
        sent=sent,
        u=u,
        until=float(sent[-1]) + gap,
        frame_age=max(0.0, float(np.median(ages))) if ages.size else None,
    )


def _number(row: Row, column: str, path: Path, optional: bool = False) -> float:
    """Return the number in a column of a row; NaN if it is `optional` and missing."""
    text = row.get(column, "").strip()
    if not text and optional:
        return math.nan
    try:
        found = float(text)
    except ValueError:
        found = math.inf
    if abs(found) > LENGTH_MAX or (math.isnan(found) and not optional):
        wrong = f"{text[:60]!r} is not a number of at most {LENGTH_MAX:g}"
        raise UsageError(f"{path}: {column}: {wrong}") from None
    return found

"""The data of identification: tracked poses of robots and the directions sent to them, from logs or
from the CSV files of `tetractl export`, poses in one file and commands in another.
"""

import math
import re
from array import array
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.commands import FieldOff
from tetractl.core.errors import UsageError
from tetractl.core.poses import Bools, Floats
from tetractl.core.table.table_files import read_csv
from tetractl.log.read.trial_log import TrialLog
from tetractl.log.read.validate import VALUE_MAX
from tetractl.model.wheels import body_velocity

Row = dict[str, str]
POSES_MAX = 2_000_000  # largest number of poses of a trial
SETTLED_S = 0.5  # time from the first direction after a pause until all robots drive again


@dataclass(frozen=True, slots=True)
class Track:
    """One trial of N robots: M camera frames and C commands, times in seconds of one clock.

    `time` (M,) is when each frame was exposed, `poses` (M, N, 3) are x, y [length unit] and heading
    [rad], `valid` (M, N) is False if a robot was not tracked. `sent` (C,) is when each command was
    sent and `u` (C,) its direction [rad]. Data after `until` [s], when the robots receive a stop,
    are not used. `frame_age` is the median time [s] from a frame's exposure to the sending of the
    command decided on it, None if unknown. `left_out` are robots that were seen too briefly. Robots
    that receive nothing for `watchdog` [s] stop. `strength` is that of the field in
    `strength_unit`, None if the spec does not state it. `twists` (C, N, 2) are speed
    [length unit/s] and turning rate [rad/s] that each robot was sent, NaN where it was sent none;
    without any, C is 0. `own` (M, N) are the times of robots' poses [s], `time` for all if it is
    empty.
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
    left_out: tuple[str, ...] = ()
    watchdog: float = math.inf
    strength: float | None = None
    strength_unit: str = "mT"
    twists: Floats = field(default_factory=lambda: np.zeros((0, 0, 2)))
    own: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def exposed(self) -> Floats:
        """The times of the poses (M, N) [s]."""
        if self.own.size:
            return self.own
        return np.repeat(self.time[:, None], len(self.names), axis=1)


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
        own=log.exposed_ns / SECOND,
        valid=log.valid & ~_paused(log)[:, None],
        sent=np.array([one.sent_ns for one in sent], dtype=float) / SECOND,
        u=np.array([one.direction for one in sent], dtype=float),
        until=last / SECOND,
        frame_age=float(np.median(ages)) / SECOND if ages else None,
        watchdog=setup.watchdog_s,
        strength=setup.strength,
        strength_unit=setup.strength_unit,
    )


def wheels_of(log: TrialLog) -> Track:
    """Return the track of a log with the speeds and turning rates that wheels were sent, by (21)-
    (23) with the spec's radius; UsageError if the robots have no wheels."""
    setup, track = log.start.setup, track_of(log)
    sent = [(c.sent_ns, c.left, c.right) for c in log.commands]
    driven = [(t, a, b) for t, a, b in sent if a is not None and b is not None]
    if not driven or setup.wheel_radius is None:
        raise UsageError(f"{log.path}: has no speeds of wheels")
    left, right = np.array([[a, b] for _, a, b in driven]).transpose(1, 0, 2)
    twists = np.stack(body_velocity(left, right, setup.wheel_radius), axis=-1)
    when = np.array([t for t, _, _ in driven]) / SECOND
    return replace(track, sent=when, u=np.full(len(when), math.nan), twists=twists)


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
    if any(isinstance(one.action, FieldOff) for one in log.commands):
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


def require_same(tracks: list[Track]) -> None:
    """Raise UsageError if tracks are not of the same robots in the same unit and field."""
    first = tracks[0]
    for other in tracks[1:]:
        if (other.strength, other.strength_unit) != (first.strength, first.strength_unit):
            raise UsageError(
                f"{other.source}: the field's strength differs from that of {first.source}",
                "identify them separately: a depends on it",
            )
        if (other.names, other.unit) != (first.names, first.unit):
            raise UsageError(
                f"{other.source}: robots or length unit differ from those of {first.source}",
                "identify them separately",
            )


ORIGIN = "CSV"
POSE_COLUMNS = ("time_s", "robot", "heading_rad")
COMMAND_COLUMNS = ("time_s", "direction_rad")
_POSITION = re.compile(r"x_(um|mm|cm|m)$")
_SPEED = re.compile(r"(v|left|right|radius)_(um|mm|cm|m)(_s)?$")

ROBOTS_MAX, TRIALS_MAX = 1000, 10_000
"""Largest numbers of robots and trials in CSV files."""

Trial = tuple[str, str]


@dataclass(slots=True)
class _Numbers:
    """The numbers of a trial in CSV files: time, robot, x, y and heading of each pose; time,
    direction and time of observation of each command; time, speed and turning rate of each of the
    `twists` of a robot, "" for all. NaN is an unknown number.
    """

    path: Path
    robots: dict[str, int] = field(default_factory=dict)
    poses: "array[float]" = field(default_factory=lambda: array("d"))
    commands: "array[float]" = field(default_factory=lambda: array("d"))
    twists: "dict[str, array[float]]" = field(default_factory=dict)


def csv_tracks(
    paths: list[Path],
    rows_of: Callable[[Path], Iterator[Row]] = read_csv,
    shortest_s: float = 0.0,
) -> list[Track]:
    """Return the tracks in some CSV files, each of poses or of commands.

    Poses are rows of time_s, robot, x_UNIT, y_UNIT, heading_rad and perhaps valid; commands of
    time_s, direction_rad and perhaps observed_s, or of time_s, v_UNIT_s and w_rad_s, or of time_s,
    left_UNIT_s, right_UNIT_s and radius_UNIT, and perhaps robot. Columns path and trial, if
    present, assign poses and commands to tracks. `rows_of` reads the rows of a file; robots that
    are seen for less than `shortest_s` [s] are left out. Raises UsageError if data are missing, or
    very many.
    """
    trials: dict[Trial, _Numbers] = {}
    unit = ""
    for path in paths:
        rows = rows_of(path)
        first = next(rows, {})
        commands = all(name in first for name in COMMAND_COLUMNS)
        speeds = {m[1]: name for name in first if (m := _SPEED.match(name))}
        if not commands and not speeds:
            unit = _unit(first, unit, path)
        for row in chain([first], rows):
            trial = row.get("path", ""), row.get("trial", "")
            one = trials.setdefault(trial, _Numbers(path))
            if commands:
                one.commands.extend(_number(row, column, path) for column in COMMAND_COLUMNS)
                one.commands.append(_number(row, "observed_s", path, True))
            elif speeds:
                sent = one.twists.setdefault(row.get("robot", ""), array("d"))
                sent.extend((_number(row, "time_s", path), *_twist(row, speeds, path)))
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
    lonely = sorted(
        trial for trial, one in trials.items() if not (one.poses and (one.commands or one.twists))
    )
    if lonely:
        raise UsageError(
            f"{trials[lonely[0]].path}: both poses and commands are needed for each trial",
            "name both files, such as poses.csv steps.csv of `tetractl export`",
        )
    return [_track(one, unit, trial, shortest_s) for trial, one in trials.items()]


def _unit(columns: Collection[str], unit: str, path: Path) -> str:
    """Return the length unit of a file of poses by its columns, which must be the given one."""
    if not all(name in columns for name in POSE_COLUMNS):
        raise UsageError(
            f"{path}: contains neither poses nor commands",
            f"poses have the columns {', '.join(POSE_COLUMNS)}, x_mm, y_mm; commands "
            f"{' and '.join(COMMAND_COLUMNS)}, or time_s, v_mm_s and w_rad_s",
        )
    found = next((m[1] for name in columns if (m := _POSITION.match(name))), None)
    if found is None or (unit and unit != found):
        raise UsageError(f"{path}: needs columns x_mm and y_mm, or both with another unit")
    return found


def _track(trial: _Numbers, unit: str, name: Trial, shortest_s: float) -> Track:
    rows = np.array(trial.poses).reshape(-1, 5)
    brief = {
        robot: number
        for robot, number in trial.robots.items()
        if np.ptp(rows[rows[:, 1] == number, 0]) < shortest_s
    }
    rows = rows[~np.isin(rows[:, 1], list(brief.values()))]
    names = [robot for robot in trial.robots if robot not in brief]
    if not names:
        raise UsageError(f"{trial.path}: has no robot that is seen for {shortest_s:g} s")
    _, rows[:, 1] = np.unique(rows[:, 1], return_inverse=True)
    time, frame = np.unique(rows[:, 0], return_inverse=True)
    if len(time) * len(names) > POSES_MAX:
        what = f"{len(names)} robots at {len(time)} times"
        raise UsageError(f"{trial.path}: has {what}; at most {POSES_MAX} poses are read of a trial")
    found = np.full((len(time), len(names), 3), np.nan)
    found[frame, rows[:, 1].astype(int)] = rows[:, 2:]
    valid: Bools = ~np.isnan(found[..., 0] + found[..., 1] + found[..., 2])
    commands = np.array(trial.commands).reshape(-1, 3)
    ages = (commands[:, 0] - commands[:, 2])[1:]
    ages = ages[np.isfinite(ages)]
    sent, u, _ = commands[np.argsort(commands[:, 0], kind="stable")].T
    gap = float(np.median(np.diff(sent))) if len(sent) > 1 else 0.0
    twists = np.zeros((0, 0, 2))
    if trial.twists:
        each = {robot: np.array(rows).reshape(-1, 3) for robot, rows in trial.twists.items()}
        sent = np.unique(np.concatenate([rows[:, 0] for rows in each.values()]))
        twists = np.full((len(sent), len(names), 2), np.nan)
        for i, robot in enumerate(names):
            own = each.get(robot, each.get("", np.zeros((0, 3))))
            twists[np.searchsorted(sent, own[:, 0]), i] = own[:, 1:]
        u = np.full(len(sent), np.nan)
    return Track(
        source=name[0] or str(trial.path),
        origin=ORIGIN,
        unit=unit,
        names=tuple(names),
        time=time,
        poses=np.where(valid[..., None], found, 0.0),
        valid=valid,
        sent=sent,
        u=u,
        until=float(sent[-1]) + gap,
        frame_age=max(0.0, float(np.median(ages))) if ages.size else None,
        left_out=tuple(brief),
        twists=twists,
    )


def _twist(row: Row, columns: dict[str, str], path: Path) -> tuple[float, float]:
    """Return speed and turning rate of a row with columns of either, or of wheels."""
    if "v" in columns:
        return _number(row, columns["v"], path), _number(row, "w_rad_s", path)
    try:
        left, right, radius = (_number(row, columns[k], path) for k in ("left", "right", "radius"))
    except KeyError:
        hint = "commands have v_mm_s and w_rad_s, or left_mm_s, right_mm_s and radius_mm"
        raise UsageError(f"{path}: a column of the wheels is missing", hint) from None
    if radius <= 0:
        raise UsageError(f"{path}: {columns['radius']} must be above 0")
    return (left + right) / 2, (right - left) / (2 * radius)


def _number(row: Row, column: str, path: Path, optional: bool = False) -> float:
    """Return the number in a column of a row; NaN if it is `optional` and missing."""
    text = row.get(column, "").strip()
    if not text and optional:
        return math.nan
    try:
        found = float(text)
    except ValueError:
        found = math.inf
    if abs(found) > VALUE_MAX or (math.isnan(found) and not optional):
        wrong = f"{text[:60]!r} is not a number of at most {VALUE_MAX:g}"
        raise UsageError(f"{path}: {column}: {wrong}") from None
    return found

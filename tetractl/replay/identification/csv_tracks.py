"""Tracks from CSV files, of `tetractl export` or of other programs: poses in one file, the
directions or speeds that robots were sent in another.
"""

import math
from array import array
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import numpy as np

from tetractl.core.errors import UsageError, printable
from tetractl.core.poses import Bools, Floats, turn_problem, wrap
from tetractl.replay.identification.measured_poses import jumps_of, measured
from tetractl.replay.identification.motion_angle import PoseSteps, check_angle
from tetractl.replay.identification.one_recording import (
    Span,
    clock_remark,
    refuse_pause,
    refuse_sparse,
)
from tetractl.replay.identification.sent_directions import (
    DELAYS_S,
    FOLLOWED,
    SentDirections,
    TurnedCourse,
    check_clock_rate,
    check_directions,
    check_rotation,
    courses_of_headings,
    image,
    other_readings,
)
from tetractl.replay.identification.tracks import Track
from tetractl.tools.table.csv_rows import CsvRow
from tetractl.tools.table.motive import table_rows
from tetractl.tools.table.quantities import (
    METRES,
    METRES_S,
    RADIANS,
    RADIANS_S,
    SECONDS,
    TIME_NAMES,
    NumberColumn,
    earlier,
    find_column,
    find_date,
    find_time,
    name_and_unit,
    refuse_degrees,
    truth,
)

POSES_MAX = 2_000_000  # largest number of poses of a trial
ROBOTS_MAX = 1000
TRIALS_MAX = 10_000
"""Largest numbers of robots and trials in CSV files."""
ORIGIN = "CSV"
ONE_ROBOT = "robot"
"""The name of the robot of a table that names none."""
POSES = "poses"
DIRECTIONS = "directions"
SPEEDS = "speeds"
OF_WHEELS = "speeds of wheels"
FORMS = {
    DIRECTIONS: ("direction_rad",),
    SPEEDS: ("v_mm_s", "w_rad_s"),
    OF_WHEELS: ("left_mm_s", "right_mm_s", "radius_mm"),
    POSES: ("x_mm", "y_mm", "heading_rad"),
}
"""The columns of each kind of table, besides the time. A table that has those of several is of the
first."""
UNITS = {"rad": RADIANS, "rad_s": RADIANS_S, "mm": METRES, "mm_s": METRES_S}
"""The units in which a column may be instead of that in FORMS."""
INSTEAD = {
    ("time_s", "frame"): "time_s is the number of the frame over the pictures per second",
    ("heading_rad", "theta"): "name theta heading_rad, or heading_deg",
    ("heading_rad", "yaw"): "name yaw heading_rad, or heading_deg",
    ("heading_rad", "qz"): "heading_rad is 2 atan2(qz, qw)",
    ("x_mm", "x_px"): "multiply x_px and y_px by the size of a pixel, and name them x_mm and y_mm",
    ("v_mm_s", "vx"): "name vx v_mm_s, or v_m_s",
    ("v_mm_s", "v_km_h"): "divide v_km_h by 3.6, and name it v_m_s",
    ("w_rad_s", "omega"): "name omega w_rad_s, or w_deg_s",
    ("w_rad_s", "w_rpm"): "multiply w_rpm by 6, and name it w_deg_s",
}
"""What to do if a table lacks a column, and has another instead."""
AGAIN = 0.1
"""Share of the time so far, from its begin, within which a time that falls starts again."""
ALONG = 0.5
"""Share of their ways that an angle to the headings explains at least."""
NO_MEASUREMENT = 0.01
"""Share of a robot's poses that are no measurement, above which it is said."""
WAY_STEP_S = 0.5
"""Duration of the steps by which the robots' way is measured [s]: noise adds little to it."""
POSES_MIN = 20
"""Least number of poses by which the angle between motion and heading is evaluated."""
JUMP = 10.0
"""Median ways between two poses, above which a way is no motion but a wrong place; chosen."""
COPIES = 0.9
COPIES_MIN = 5
TURNED = 0.01
ALIKE = 1e-3
"""Share of the headings, and their least number, that have TURNED [rad] since the pose before and
are now the direction that acts within ALIKE [rad], as none is that is measured: copies of it."""
COLUMNS_SAID = 8
"""Largest number of columns that a message names."""
BOTH_FILES = "name both files, such as poses.csv steps.csv of `tetractl export`"
"""A hint."""

Trial = tuple[str, str]
Series = tuple[str, str]
"""Rows in the order of their times: what they state, and of which robot."""


@dataclass(slots=True)
class _Numbers:
    """The numbers of a trial in CSV files: time, robot, x, y and heading of each pose; time,
    direction, time of observation and line of each of the `commands` of a robot, and the column of
    directions; the time constant of the wheels [s], 0 if none is stated; time, speed and turning
    rate of each of the `twists` of a robot. A robot "" stands for all. NaN is an unknown number.
    `first` and `newest` are the times [s] of what is in the files, by its column and robot. The
    paths are of the files.
    """

    robots: dict[str, int] = field(default_factory=dict)
    poses: "array[float]" = field(default_factory=lambda: array("d"))
    poses_path: Path | None = None
    commands: "dict[str, array[float]]" = field(default_factory=dict)
    direction: NumberColumn | None = None
    lag_s: float = 0.0
    twists: "dict[str, array[float]]" = field(default_factory=dict)
    commands_path: Path | None = None
    first: dict[Series, float] = field(default_factory=dict)
    newest: dict[Series, float] = field(default_factory=dict)

    def take_time(self, path: Path, row: CsvRow, column: NumberColumn, series: Series) -> float:
        """Return the time of a row, which is not earlier than the row before it of its series;
        UsageError if it is."""
        time = column.number(path, row)
        first = self.first.setdefault(series, time)
        newest = self.newest.get(series, time)
        if time < newest and abs(time - first) <= AGAIN * (newest - first):
            hint = "two recordings? number them in a column trial"
            if not series[1]:
                hint += "; two robots? name them in a column robot"
            raise UsageError(f"{path}, line {row.line}: the time starts again", hint)
        if time < newest:
            raise earlier(path, row, "; two recordings? number them in a column trial instead")
        self.newest[series] = time
        return time


@dataclass(frozen=True, slots=True)
class _Columns:
    """The columns of a table of one of FORMS: the time, and the others by name; of a table of
    poses the `unit` of its lengths."""

    path: Path
    form: str
    time: NumberColumn
    by_name: Mapping[str, NumberColumn]
    unit: str = ""

    def number(self, row: CsvRow, name: str) -> float:
        """Return the number in a row of a column, NaN if the row or the table has none."""
        column = self.by_name.get(name)
        return math.nan if column is None else column.optional(self.path, row)

    def wrong(self, row: CsvRow, name: str, problem: str) -> UsageError:
        """Return the error of the number in a row of a column."""
        return UsageError(f"{self.path}, line {row.line}: {self.by_name[name].key} {problem}")


def _add_pose(trial: _Numbers, columns: _Columns, row: CsvRow) -> None:
    """Add the pose in a row: it is unknown if it is not valid or a number is missing."""
    trial.poses_path = columns.path
    robot = row.cells.get("robot", "")
    number = trial.robots.setdefault(robot, len(trial.robots))
    valid = truth(columns.path, row, "valid")
    time = trial.take_time(columns.path, row, columns.time, ("poses", robot))
    pose = [columns.number(row, name) for name in ("x", "y", "heading")]
    trial.poses.extend((time, number))
    trial.poses.extend(pose if valid else [math.nan] * len(pose))


def _add_direction(trial: _Numbers, columns: _Columns, row: CsvRow) -> None:
    """Add the direction in a row; one without it is a step at which nothing was sent."""
    trial.commands_path = columns.path
    direction = columns.number(row, "direction")
    if math.isnan(direction):
        return
    observed = columns.number(row, "observed")
    robot = row.cells.get("robot", "")
    time = trial.take_time(columns.path, row, columns.time, ("directions", robot))
    of_robot = trial.commands.setdefault(robot, array("d"))
    of_robot.extend((time, direction, observed, row.line))
    trial.direction = columns.by_name["direction"]
    lag = columns.by_name.get("lag")
    if lag is not None:
        trial.lag_s = lag.number(columns.path, row)
        if trial.lag_s < 0:
            raise columns.wrong(row, "lag", "must not be negative")


def _add_speeds(trial: _Numbers, columns: _Columns, row: CsvRow) -> None:
    """Add the speed and turning rate in a row, or those that the speeds of a robot's wheels are; if
    a number is missing, nothing was sent at this step."""
    trial.commands_path = columns.path
    if columns.form == OF_WHEELS:
        left = columns.number(row, "left")
        right = columns.number(row, "right")
        if math.isnan(left) or math.isnan(right):
            return
        radius = columns.by_name["radius"].number(columns.path, row)
        if radius <= 0:
            raise columns.wrong(row, "radius", "must be above 0")
        speed = (left + right) / 2
        turning_rate = (right - left) / (2 * radius)
    else:
        speed = columns.number(row, "v")
        turning_rate = columns.number(row, "w")
    if math.isnan(speed) or math.isnan(turning_rate):
        return
    robot = row.cells.get("robot", "")
    time = trial.take_time(columns.path, row, columns.time, ("twists", robot))
    trial.twists.setdefault(robot, array("d")).extend((time, speed, turning_rate))


ADD = {
    DIRECTIONS: _add_direction,
    SPEEDS: _add_speeds,
    OF_WHEELS: _add_speeds,
    POSES: _add_pose,
}
"""What adds a row of each kind of table to the numbers of its trial."""


def csv_tracks(paths: list[Path]) -> list[Track]:
    """Return the tracks in some CSV files, each of poses or of commands.

    Poses are rows of time_s, robot, x_UNIT, y_UNIT, heading_rad and perhaps valid; commands of
    time_s, direction_rad and perhaps observed_s and lag_s, or of time_s, v_UNIT_s and w_rad_s, or
    of time_s, left_UNIT_s, right_UNIT_s and radius_UNIT, and perhaps robot. Times may be in other
    units and count from anywhere, angles may be in degrees. Columns log and trial, if present,
    assign poses and commands to tracks. A table without robot is of one; a file may be one of
    Motive. Robots that are never seen, or are not sent any speed where others are, are left out.
    Raises UsageError if data are missing, very many, or of clocks that do not meet.
    """
    _refuse_twice(paths)
    trials: dict[Trial, _Numbers] = {}
    unit = ""
    for path in paths:
        rows = table_rows(path)
        first = next(rows, None)
        if first is None:
            raise UsageError(f"{path}: has no rows")
        columns = _columns(path, first.cells)
        if columns.form == POSES:
            if unit and unit != columns.unit:
                raise UsageError(f"{path}: its lengths are in {columns.unit}, others in {unit}")
            unit = columns.unit
        for row in chain([first], rows):
            trial = row.cells.get("log", row.cells.get("path", "")), row.cells.get("trial", "")
            numbers = trials.setdefault(trial, _Numbers())
            ADD[columns.form](numbers, columns, row)
            if len(numbers.robots) > ROBOTS_MAX or len(trials) > TRIALS_MAX:
                raise UsageError(
                    f"{path}: has more than {ROBOTS_MAX} robots or {TRIALS_MAX} trials"
                )
    idle = _idle_robots(list(trials.values()))
    unseen = _unseen_robots(list(trials.values()))
    return [_track(numbers, unit, trial, idle, unseen) for trial, numbers in trials.items()]


def _idle_robots(trials: list[_Numbers]) -> set[str]:
    """Return the robots to which no trial sends a speed; UsageError if there is no other, or if it
    is not known which robot is sent one."""
    paths = next((numbers for numbers in trials if numbers.poses_path), _Numbers())
    in_poses = {robot for numbers in trials for robot in numbers.robots}
    sent_to = {robot for numbers in trials for robot in numbers.twists}
    if "" in sent_to or not sent_to or not in_poses:
        return set()
    receivers = _names(sent_to)
    if in_poses == {""}:
        if len(sent_to) == 1:
            return set()
        raise UsageError(
            f"{paths.poses_path}: has no column robot, and commands are for {receivers}",
            "name the robot of each pose in a column robot",
        )
    idle = in_poses - sent_to
    if idle == in_poses:
        raise UsageError(
            f"{paths.commands_path}: no command is for {_names(in_poses)}; commands are for "
            f"{receivers}",
            "name robots alike in both files",
        )
    return idle


def _names(robots: Collection[str]) -> str:
    """Return the names of robots as text."""
    return ", ".join(printable(robot) or "rows without a robot" for robot in sorted(robots))


def _unseen_robots(trials: list[_Numbers]) -> set[str]:
    """Return the robots of which no trial has a pose."""
    with_pose = set[str]()
    for numbers in trials:
        rows = np.array(numbers.poses).reshape(-1, 5)
        whole_rows = rows[np.isfinite(rows).all(axis=1)]
        numbers_with_pose = set(whole_rows[:, 1].tolist())
        with_pose.update(
            robot for robot, number in numbers.robots.items() if number in numbers_with_pose
        )
    return {robot for numbers in trials for robot in numbers.robots} - with_pose


def _refuse_twice(paths: list[Path]) -> None:
    """Raise UsageError for a file that is named twice: its rows would count twice."""
    files = set[Path]()
    for path in paths:
        file = path.resolve()
        if file in files:
            raise UsageError(f"{path}: is named twice", BOTH_FILES)
        files.add(file)


def _columns(path: Path, headers: Mapping[str, str]) -> _Columns:
    """Return the columns of a file of poses or of commands, of its first row by `headers`;
    UsageError if it is neither."""
    named = {name_and_unit(header)[0] for header in headers}
    time = find_date(headers) or find_time(path, headers)
    present: dict[str, int] = {}
    for form, columns in FORMS.items():
        quantities = dict(map(name_and_unit, columns))
        present[form] = len(named & quantities.keys())
        if present[form] < len(columns) or time is None:
            continue
        if form == POSES:
            unit, x, y = _position_columns(path, headers)
            heading = _required(path, headers, "heading", RADIANS)
            return _Columns(path, form, time, {"x": x, "y": y, "heading": heading}, unit)
        by_name = {
            name: _required(path, headers, name, UNITS[unit]) for name, unit in quantities.items()
        }
        if form == DIRECTIONS:
            for name in ("observed", "lag"):
                column = find_column(path, headers, (name,), SECONDS)
                if column is not None:
                    by_name[name] = column
        return _Columns(path, form, time, by_name)
    raise _incomplete(path, headers, present)


def _incomplete(path: Path, headers: Collection[str], present: dict[str, int]) -> UsageError:
    """Return the error that a table lacks columns of the form of which it has most, `present`."""
    has = ", ".join(printable(header) for header in list(headers)[:COLUMNS_SAID])
    likeliest = max(reversed(present), key=lambda form: present[form])
    said = "contains neither poses nor commands"
    hint = (
        "poses have the columns time_s, robot, x_mm, y_mm, heading_rad; commands time_s and "
        "direction_rad, or time_s, v_mm_s and w_rad_s, or left_mm_s, right_mm_s and radius_mm"
    )
    if present[likeliest]:
        named = {name_and_unit(header)[0] for header in headers}
        lacks = [] if named & set(TIME_NAMES) else ["time_s"]
        lacks += [column for column in FORMS[likeliest] if name_and_unit(column)[0] not in named]
        said = f"contains {likeliest} without {' and '.join(lacks)}"
        remedies = [
            remedy
            for (lacked, instead), remedy in INSTEAD.items()
            if lacked in lacks and instead in named
        ]
        hint = "; ".join(remedies) or hint
    return UsageError(f"{path}: {said}: its columns are {has}", hint)


def _required(
    path: Path, headers: Collection[str], name: str, units: Mapping[str, float]
) -> NumberColumn:
    """Return the column of a name that some header has; UsageError if its unit is another."""
    column = find_column(path, headers, (name,), units)
    assert column is not None
    return column


def _position_columns(
    path: Path, headers: Collection[str]
) -> tuple[str, NumberColumn, NumberColumn]:
    """Return the unit of positions, and the columns of x and y in it."""
    named = {name_and_unit(header): header for header in headers}
    for unit in METRES:
        if ("x", unit) in named and ("y", unit) in named:
            return unit, NumberColumn(named["x", unit]), NumberColumn(named["y", unit])
    raise UsageError(f"{path}: needs columns x_mm and y_mm, or both with another unit")


def _track(numbers: _Numbers, unit: str, name: Trial, idle: set[str], unseen: set[str]) -> Track:
    """Return the track of a trial without some robots, its times counted from its first pose."""
    poses_path = numbers.poses_path
    commands_path = numbers.commands_path
    if poses_path is None or commands_path is None:
        raise UsageError(
            f"{poses_path or commands_path}: both poses and commands are needed for each trial",
            BOTH_FILES,
        )
    rows = np.array(numbers.poses).reshape(-1, 5)
    _refuse_two_places(poses_path, rows, list(numbers.robots))
    begin = float(rows[:, 0].min())
    rows[:, 0] -= begin
    robots = {robot: k for robot, k in numbers.robots.items() if robot not in idle | unseen}
    rows = rows[np.isin(rows[:, 1], list(robots.values()))]
    if not robots:
        raise UsageError(f"{poses_path}: has no robot that is seen")
    names = tuple(robot or ONE_ROBOT for robot in robots)
    time, poses, valid = _frames(poses_path, rows, len(names))
    sent = (
        _twists(numbers, list(robots), unit, begin)
        if numbers.twists
        else _directions(numbers, begin)
    )
    if not len(sent.when):
        raise UsageError(f"{commands_path}: states no direction or speed")
    _check_degrees(poses_path, poses, valid)
    _refuse_copies(poses_path, names, time, poses, sent)
    seen_at = [rows[rows[:, 1] == number, 0] for number in robots.values()]
    refuse_sparse(str(poses_path), min(seen_at, key=_usual_gap))
    refuse_pause(str(poses_path), begin + time)
    valid, remarks = _measured(poses_path, names, begin + time, poses, valid)
    if not numbers.twists:
        _check_angles(poses_path, names, time, poses, valid)
    unsent = idle & set(numbers.robots)
    if unsent:
        receivers = _names(numbers.twists)
        remarks.append(
            f"{commands_path}: no command is for {_names(unsent)}; commands are for {receivers}"
        )
    in_poses = set(numbers.robots)
    never_seen = (unseen - idle) & in_poses
    if "" not in in_poses:
        never_seen |= set(numbers.twists) - in_poses - {""}
    if never_seen:
        remarks.append(f"{poses_path}: no pose is of {_names(never_seen)}")
    until = float(sent.when[-1]) + _usual_gap(sent.when)
    poses_span = Span(str(poses_path), begin, begin + float(time[-1]))
    commands_span = Span(str(commands_path), begin + float(sent.when[0]), begin + until)
    of_way = _share_of_way(time, poses, float(sent.when[0]), until)
    remark = clock_remark(poses_span, begin + sent.when, commands_span, of_way)
    if remark is not None:
        remarks.append(remark)
    if not numbers.twists:
        directions = SentDirections(begin + sent.when, sent.u)
        least = FOLLOWED if remark is None else 0.0
        measured_poses = np.where(valid[..., None], poses, np.nan)
        _check_turning(poses_path, commands_path, begin + time, measured_poses, directions, least)
    return Track(
        source=name[0] or str(poses_path),
        origin=ORIGIN,
        unit=unit,
        names=names,
        time=time,
        poses=np.where(valid[..., None], poses, 0.0),
        valid=valid,
        sent=sent.when,
        u=sent.u,
        until=until,
        frame_age=sent.frame_age,
        lag=numbers.lag_s,
        on_wheels=True,
        all_commands=numbers.lag_s == 0,
        rates_unstated=numbers.lag_s > 0 and not name[0],
        twists=sent.twists,
        remarks=tuple(remarks),
    )


def _refuse_two_places(path: Path, rows: Floats, names: list[str]) -> None:
    """Raise UsageError if a robot is at two places at one time: its rows are of several robots.

    Rows (R, 5) are time, robot, x, y and heading; a row that is written twice does no harm.
    """
    ordered = rows[np.lexsort((rows[:, 0], rows[:, 1]))]
    before = ordered[:-1]
    after = ordered[1:]
    at_once = (before[:, :2] == after[:, :2]).all(axis=1)
    apart = np.abs(before[:, 2:4] - after[:, 2:4]).max(axis=1) > 0
    twice = np.flatnonzero(at_once & apart)
    if len(twice):
        time, robot = after[twice[0], :2]
        name = printable(names[int(robot)] or ONE_ROBOT)
        hint = "are these poses of several robots, or times that are rounded?"
        if not names[int(robot)]:
            hint = "several robots? name them in a column robot"
        raise UsageError(f"{path}: {name} is at two places at {time:.15g} s", hint)


def _usual_gap(times: Floats) -> float:
    """Return the median time between increasing times, 0 for a single one."""
    if len(times) < 2:
        return 0.0
    gaps = np.diff(times)
    return float(np.median(gaps))


def _frames(path: Path, rows: Floats, count: int) -> tuple[Floats, Floats, Bools]:
    """Return times (M,), poses (M, N, 3) and which of these are known (M, N), of rows (R, 5) of
    time, robot, x, y and heading."""
    _, robots = np.unique(rows[:, 1], return_inverse=True)
    time, frames = np.unique(rows[:, 0], return_inverse=True)
    if len(time) * count > POSES_MAX:
        what = f"{count} robots at {len(time)} times"
        raise UsageError(f"{path}: has {what}; at most {POSES_MAX} poses are read of a trial")
    poses = np.full((len(time), count, 3), np.nan)
    poses[frames, robots] = rows[:, 2:]
    return time, poses, np.logical_not(np.isnan(poses[..., 0] + poses[..., 1] + poses[..., 2]))


def _share_of_way(time: Floats, poses: Floats, begin_s: float, end_s: float) -> float:
    """Return the share of their way that robots drive from `begin_s` to `end_s` [s], in steps of
    WAY_STEP_S: robots that stand before their first command and after their last need none."""
    _, rows = np.unique(time // WAY_STEP_S, return_index=True)  # the first pose in each step
    moved = np.diff(poses[rows, :, :2], axis=0)
    way = np.nansum(np.hypot(moved[..., 0], moved[..., 1]), axis=1)
    acts = (time[rows[1:]] > begin_s) & (time[rows[:-1]] < end_s)
    if not way.any():
        return 1.0
    return float(way[acts].sum() / way.sum())


def _check_degrees(path: Path, poses: Floats, valid: Bools) -> None:
    """Raise UsageError for headings in degrees: beyond a turn, and at one angle to the motion,
    there and back, only as degrees. Those of `tetractl export` count whole turns in rad.
    """
    beyond = float(np.abs(poses[valid][:, 2]).max(initial=0.0))
    problem = turn_problem(beyond)
    if problem is None:
        return
    in_rad = 0.0
    in_degrees = 0.0
    ways = 0.0
    for robot in range(poses.shape[1]):
        x, y, heading = poses[valid[:, robot], robot].T
        way = np.diff(x + 1j * y)
        way *= np.abs(way) <= JUMP * np.median(np.abs(way))
        squares = way**2
        ways += float(np.abs(squares).sum())
        as_rad = heading[:-1]
        as_degrees = np.radians(as_rad)
        in_rad += abs((squares * np.exp(-2j * as_rad)).sum())
        in_degrees += abs((squares * np.exp(-2j * as_degrees)).sum())
    if in_degrees > max(in_rad, ALONG * ways):
        said, hint = problem
        raise UsageError(
            f"{path}: a heading of {beyond:g} {said}", f"{hint}, or name the column heading_deg"
        )


def _refuse_copies(
    path: Path, names: tuple[str, ...], time: Floats, poses: Floats, sent: "_Sent"
) -> None:
    """Raise UsageError if the headings in poses (M, N, 3) are the directions that were sent, at
    their times or a command before or after."""
    newest = np.searchsorted(sent.when, time, side="right") - 1
    near = np.clip(newest[:, None] + np.array([-1, 0, 1]), 0, len(sent.when) - 1)
    for robot, name in enumerate(names):
        headings = poses[:, robot, 2]
        off = np.abs(wrap(headings[:, None] - sent.u[near])).min(axis=1)
        turned = np.abs(wrap(np.diff(headings))) > TURNED
        is_copy = off[1:][turned] < ALIKE
        if len(is_copy) >= COPIES_MIN and is_copy.mean() > COPIES:
            raise UsageError(
                f"{path}: the headings of {printable(name)} are the directions that were sent",
                "give the headings that were measured",
            )


def _measured(
    path: Path, names: tuple[str, ...], time: Floats, poses: Floats, valid: Bools
) -> tuple[Bools, list[str]]:
    """Return which poses (M, N, 3) are measurements (M, N), and what to say of robots of which a
    share above NO_MEASUREMENT is none, or that jump."""
    is_measured = np.zeros_like(valid)
    said: list[str] = []
    jumped: list[str] = []
    for robot, name in enumerate(names):
        rows = np.flatnonzero(valid[:, robot])
        measured_rows = rows[measured(time[rows], poses[rows, robot])]
        is_measured[measured_rows, robot] = True
        share = 1 - len(measured_rows) / max(len(rows), 1)
        if share > NO_MEASUREMENT:
            said.append(f"{share:.1%} of {printable(name)}")
        jumps = jumps_of(time[measured_rows], poses[measured_rows, robot])
        if len(jumps):
            jumped.append(f"{printable(name)} at {time[measured_rows[jumps[0]]]:.2f} s")
    remarks: list[str] = []
    if said:
        text = f"{path}: poses that repeat the one before, or jump away and back, are left out"
        remarks.append(f"{text}: {', '.join(said)}")
    if jumped:
        text = f"{path}: poses jump and stay there: {', '.join(jumped)}"
        remarks.append(f"{text}: is it another robot from then on, or was it carried?")
    return is_measured, remarks


def _check_angles(
    path: Path, names: tuple[str, ...], time: Floats, poses: Floats, valid: Bools
) -> None:
    """Raise UsageError if robots that follow directions do not move along their headings."""
    for robot, name in enumerate(names):
        rows = np.flatnonzero(valid[:, robot])
        if len(rows) >= POSES_MIN:
            steps = PoseSteps.of(time[rows], poses[rows, robot])
            check_angle(str(path), printable(name), steps, steps.duration_s)


def _check_turning(
    poses_path: Path,
    commands_path: Path,
    time: Floats,
    poses: Floats,
    directions: SentDirections,
    least: float,
) -> None:
    """Raise UsageError if robots turn by other directions than those that they were sent, or these
    explain less than a share `least` of their turning."""
    turned: list[TurnedCourse] = []
    for headings in poses[..., 2].T:
        measured = np.isfinite(headings)
        turned += courses_of_headings(time[measured], headings[measured])
    source = str(commands_path)
    if least:
        check_clock_rate(source, turned, directions)
    readings = [
        image(str(poses_path), source, directions),
        *other_readings(source, directions, _usual_gap(time)),
    ]
    check_directions(str(poses_path), turned, directions, DELAYS_S, readings, least)
    check_rotation(str(poses_path), source, turned, directions)


@dataclass(frozen=True, slots=True)
class _Sent:
    """What was sent at times `when` (C,) [s], as `u`, `twists` and `frame_age` of a track."""

    when: Floats
    u: Floats
    twists: Floats = field(default_factory=lambda: np.zeros((0, 0, 2)))
    frame_age: float | None = None


def _directions(numbers: _Numbers, begin: float) -> _Sent:
    """Return the directions in order, their times counted from `begin`."""
    commands = np.zeros((0, 4))
    for robot, of_robot in numbers.commands.items():
        before = commands
        commands = np.array(of_robot).reshape(-1, 4)
        if len(before) and not np.array_equal(before[:, 1], commands[:, 1]):
            raise UsageError(
                f"{numbers.commands_path}: {printable(robot)} is sent other directions than others",
                "all robots are sent one direction: identify each by tables of its own",
            )
    ages = (commands[:, 0] - commands[:, 2])[1:]
    ages = ages[np.isfinite(ages)]
    when, u, _, lines = commands.T  # a table whose times fall is refused
    if numbers.direction is not None and numbers.commands_path is not None:
        rows = lines.astype(int).tolist()
        refuse_degrees(numbers.commands_path, numbers.direction, rows, u)
    age = max(0.0, float(np.median(ages))) if ages.size else None
    return _Sent(when - begin, u, frame_age=age)


def _twists(numbers: _Numbers, robots: list[str], unit: str, begin: float) -> _Sent:
    """Return the speeds and turning rates in order, their times counted from `begin`, with speeds
    in the unit of the poses."""
    of_robot = {robot: np.array(rows).reshape(-1, 3) for robot, rows in numbers.twists.items()}
    for_all = of_robot.get("", np.zeros((0, 3)))
    if robots == [""] and len(of_robot) == 1:
        (for_all,) = of_robot.values()
    when = np.unique(np.concatenate([rows[:, 0] for rows in of_robot.values()]))
    twists = np.full((len(when), len(robots), 2), np.nan)
    for i, robot in enumerate(robots):
        rows = of_robot.get(robot, for_all)
        twists[np.searchsorted(when, rows[:, 0]), i] = rows[:, 1:] / (METRES[unit], 1.0)
    return _Sent(when - begin, np.full(len(when), np.nan), twists)

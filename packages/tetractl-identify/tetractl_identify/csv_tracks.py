"""Reads tracks from CSV files: one file with poses, and another with the commands sent to robots.

docs/how-to/identify.md describes the format: a row for each pose or command, and columns whose
names end in their units. A file that Motive exported can take the place of the file of poses. The
module reads the rows one by one into the `_TrialData` of their trial. Then it joins them to a
`Track` of all robots. If something cannot be read or joined, the error names the file, the line and
the column. Whether the commands belong to the poses is checked later, when they are fitted (see
`explained`).
"""

import math
from array import array
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tetractl.core.errors import UsageError, printable
from tetractl.core.poses import Bools, Floats
from tetractl.tools.table.csv_rows import CsvRow
from tetractl.tools.table.quantities import (
    METRES,
    METRES_S,
    RADIANS,
    RADIANS_S,
    SECONDS,
    TIME_NAMES,
    NumberColumn,
    create_order_error,
    find_column,
    find_time,
    read_boolean,
    split_header,
)
from tetractl_identify.measured_poses import measured
from tetractl_identify.motive import read_table_rows
from tetractl_identify.tracks import Track

POSES_MAX = 2_000_000  # largest number of poses of a trial
ROBOTS_MAX = 1000
"""Maximum number of robots in CSV files."""
TRIALS_MAX = 10_000
"""Maximum number of trials in CSV files."""
ORIGIN = "CSV"
DEFAULT_NAME = "robot"
"""Name of the robot if a table names no robot."""
POSES = "poses"
DIRECTIONS = "directions"
SPEEDS = "speeds"
WHEEL_SPEED_TABLE = "speeds of wheels"
TABLE_COLUMNS = {
    DIRECTIONS: ("direction_rad",),
    SPEEDS: ("v_mm_s", "w_rad_s"),
    WHEEL_SPEED_TABLE: ("left_mm_s", "right_mm_s", "radius_mm"),
    POSES: ("x_mm", "y_mm", "heading_rad"),
}
"""The columns of each kind of table, in addition to the time.

If a table has the columns of several kinds, it is of the first of them.
"""
UNITS = {"rad": RADIANS, "rad_s": RADIANS_S, "mm": METRES, "mm_s": METRES_S}
"""Other units that a column can have, by its unit in TABLE_COLUMNS."""
RESTART_TOLERANCE = 0.1
"""Maximum distance of a decreased time from the first time, for a recording that starts again.

It is relative to the time that has elapsed since the first time.
"""
COLUMNS_SHOWN = 8
"""Maximum number of columns that a message names."""
BOTH_FILES_HINT = (
    "name both files, such as the poses.csv and steps.csv that `tetractl export` writes"
)
FORMAT = "docs/how-to/identify.md describes the format"
"""Hint that names the description of the format."""
RECORDING_GAP_MAX_S = 86_400.0
"""Maximum time without a pose in a recording [s]: a day."""
POSE_GAP_MAX_S = 2.0
"""Maximum median time between two poses of a robot [s]."""
LEFT_OUT_FRACTION_MAX = 0.01
"""Fraction of a robot's poses left out as no measurement, above which a remark reports it."""

POSE_ROW = np.dtype([("time", float), ("robot", float), ("pose", float, 3)])
"""A row of a table of poses.

`time` is in s, `robot` is the robot's number, and `pose` is x, y and heading [rad].
"""
DIRECTION_ROW = np.dtype([("time", float), ("direction", float), ("observed", float)])
"""A row of a table of directions [rad].

`observed` is the time of the poses from which the direction was decided, and `time` that of the
direction itself [s].
"""
TWIST_ROW = np.dtype([("time", float), ("speed", float), ("turning_rate", float)])
"""A row of a table of speeds and turning rates [rad/s]. `time` is in s."""

Trial = tuple[str, str]
Series = tuple[str, str]
"""Rows whose times must rise: the kind of the rows, and the robot."""


@dataclass(slots=True)
class _TrialData:
    """The numbers of one trial that have been read from CSV files so far.

    They are kept as flat arrays, one number after another: for each pose a POSE_ROW, and for each
    command of a robot a DIRECTION_ROW or a TWIST_ROW. NaN stands for an unknown number.

    - `robots` numbers the robots by name. The name "" stands for all robots. - `lag_s` is the time
    constant of the wheels [s], 0 if the file states none. - `first_times` and `newest_times` are
    the first and newest times [s] in a file, by column and robot. - The paths are the paths of the
    files.
    """

    robots: dict[str, int] = field(default_factory=dict)
    poses: "array[float]" = field(default_factory=lambda: array("d"))
    poses_path: Path | None = None
    directions: "dict[str, array[float]]" = field(default_factory=dict)
    lag_s: float = 0.0
    twists: "dict[str, array[float]]" = field(default_factory=dict)
    commands_path: Path | None = None
    first_times: dict[Series, float] = field(default_factory=dict)
    newest_times: dict[Series, float] = field(default_factory=dict)

    def pose_rows(self) -> NDArray[np.void]:
        """Return the POSE_ROWs (R,)."""
        return _view_as_rows(self.poses, POSE_ROW)

    def read_time(self, path: Path, row: CsvRow, column: NumberColumn, series: Series) -> float:
        """Read the time in a row, and check that times are in order.

        Args:
            path: The file.
            row: The row.
            column: The column of times.
            series: The rows that must be in order.

        Raises:
            UsageError: If the time is earlier than in the previous row.
        """
        time_s = column.number(path, row)
        first_s = self.first_times.setdefault(series, time_s)
        newest_s = self.newest_times.get(series, time_s)
        if time_s < newest_s and abs(time_s - first_s) <= RESTART_TOLERANCE * (newest_s - first_s):
            hint = "if the file holds two recordings, number them in a column named trial"
            if not series[1]:
                hint += "; if it holds two robots, name them in a column named robot"
            raise UsageError(
                f"{path}, line {row.line}: the time goes back to an earlier value", hint
            )
        if time_s < newest_s:
            raise create_order_error(
                path,
                row,
                "; if the file holds two recordings, number them in a column named trial instead",
            )
        self.newest_times[series] = time_s
        return time_s


def _view_as_rows(numbers: "array[float]", row: np.dtype[np.void]) -> NDArray[np.void]:
    """View a flat array of numbers as structured rows."""
    return np.array(numbers).view(row)


@dataclass(frozen=True, slots=True)
class _TableColumns:
    """The columns of a table of poses or commands, found in its header.

    The column of times is separate, and all others are found by their names. For a table of poses,
    `unit` is the unit of its lengths.
    """

    path: Path
    kind: str
    time: NumberColumn
    by_name: Mapping[str, NumberColumn]
    unit: str = ""

    def number(self, row: CsvRow, name: str) -> float:
        """Read the number in a column of a row. NaN if the row or the table has none."""
        column = self.by_name.get(name)
        return math.nan if column is None else column.read_optional(self.path, row)

    def create_number_error(self, row: CsvRow, name: str, problem: str) -> UsageError:
        """Create the error for a wrong number in a table.

        Args:
            row: The row.
            name: The column.
            problem: The problem with the number.
        """
        return UsageError(f"{self.path}, line {row.line}: {self.by_name[name].key} {problem}")


def _add_pose(trial: _TrialData, columns: _TableColumns, row: CsvRow) -> None:
    """Add the pose in a row to a trial. It becomes NaN if the row marks it as invalid.

    A number that the row lacks also becomes NaN.
    """
    trial.poses_path = columns.path
    robot_name = row.cells.get("robot", "")
    robot_index = trial.robots.setdefault(robot_name, len(trial.robots))
    is_valid = read_boolean(columns.path, row, "valid")
    time_s = trial.read_time(columns.path, row, columns.time, ("poses", robot_name))
    pose = [columns.number(row, name) for name in ("x", "y", "heading")]
    trial.poses.extend((time_s, robot_index))
    trial.poses.extend(pose if is_valid else [math.nan] * len(pose))


def _add_direction(trial: _TrialData, columns: _TableColumns, row: CsvRow) -> None:
    """Add the direction in a row to a trial. A row without a direction adds nothing.

    A negative lag is a `UsageError`.
    """
    trial.commands_path = columns.path
    direction_rad = columns.number(row, "direction")
    if math.isnan(direction_rad):
        return
    observed_s = columns.number(row, "observed")
    robot_name = row.cells.get("robot", "")
    time_s = trial.read_time(columns.path, row, columns.time, ("directions", robot_name))
    robot_numbers = trial.directions.setdefault(robot_name, array("d"))
    robot_numbers.extend((time_s, direction_rad, observed_s))
    lag_column = columns.by_name.get("lag")
    if lag_column is not None:
        trial.lag_s = lag_column.number(columns.path, row)
        if trial.lag_s < 0:
            raise columns.create_number_error(row, "lag", "must not be negative")


def _add_speeds(trial: _TrialData, columns: _TableColumns, row: CsvRow) -> None:
    """Add the speed and turning rate in a row.

    A row may state the speeds of the robot's wheels instead, from which both are computed. If a
    number is missing, nothing was sent at this step.
    """
    trial.commands_path = columns.path
    if columns.kind == WHEEL_SPEED_TABLE:
        left_speed = columns.number(row, "left")
        right_speed = columns.number(row, "right")
        if math.isnan(left_speed) or math.isnan(right_speed):
            return
        radius = columns.by_name["radius"].number(columns.path, row)
        if radius <= 0:
            raise columns.create_number_error(row, "radius", "must be above 0")
        speed = (left_speed + right_speed) / 2
        turning_rate = (right_speed - left_speed) / (2 * radius)
    else:
        speed = columns.number(row, "v")
        turning_rate = columns.number(row, "w")
    if math.isnan(speed) or math.isnan(turning_rate):
        return
    robot_name = row.cells.get("robot", "")
    time_s = trial.read_time(columns.path, row, columns.time, ("twists", robot_name))
    trial.twists.setdefault(robot_name, array("d")).extend((time_s, speed, turning_rate))


ROW_READERS = {
    DIRECTIONS: _add_direction,
    SPEEDS: _add_speeds,
    WHEEL_SPEED_TABLE: _add_speeds,
    POSES: _add_pose,
}
"""Functions that add a row to the numbers of its trial, by the kind of table."""


def read_csv_tracks(paths: list[Path]) -> list[Track]:
    """Read the tracks in CSV files, each of which contains poses or commands.

    A file of poses has the columns time_s, robot, x_UNIT, y_UNIT, heading_rad and, optionally,
    valid. A file of commands has one of these forms, each optionally with the column robot:

    - time_s and direction_rad, optionally observed_s and lag_s;
    - time_s, v_UNIT_s and w_rad_s;
    - time_s, left_UNIT_s, right_UNIT_s and radius_UNIT.

    Times can be in other units and can start at any value. Angles can be in degrees. The columns
    log and trial assign poses and commands to tracks. A table without the column robot belongs to
    one robot. A file of poses can also be an export of Motive. Robots that are never seen are left
    out, and so are robots that receive no speed while others do.

    Raises:
        UsageError: If data are missing, if there are too many, or if the clocks do not overlap.
    """
    _refuse_repeated_files(paths)
    trials: dict[Trial, _TrialData] = {}
    unit = ""
    for path in paths:
        rows = read_table_rows(path)
        first_row = next(rows, None)
        if first_row is None:
            raise UsageError(f"{path}: the file has no rows below its header")
        columns = _find_columns(path, first_row.cells)
        if columns.kind == POSES:
            if unit and unit != columns.unit:
                raise UsageError(
                    f"{path}: the lengths in this file are in {columns.unit}, but "
                    f"those in other files are in {unit}"
                )
            unit = columns.unit
        for row in chain([first_row], rows):
            trial = row.cells.get("log", row.cells.get("path", "")), row.cells.get("trial", "")
            numbers = trials.setdefault(trial, _TrialData())
            ROW_READERS[columns.kind](numbers, columns, row)
            if len(numbers.robots) > ROBOTS_MAX or len(trials) > TRIALS_MAX:
                raise UsageError(
                    f"{path}: the file has more than {ROBOTS_MAX} robots or {TRIALS_MAX} trials"
                )
    idle = _find_idle_robots(list(trials.values()))
    unseen = _find_unseen_robots(list(trials.values()))
    return [_join_track(numbers, unit, trial, idle, unseen) for trial, numbers in trials.items()]


def _find_idle_robots(trials: list[_TrialData]) -> set[str]:
    """Return the robots to which no trial sends a speed.

    Raises:
        UsageError: If there is no other robot, or if it is unknown which robot receives a speed.
    """
    trial_with_poses = next((numbers for numbers in trials if numbers.poses_path), _TrialData())
    posed = {robot for numbers in trials for robot in numbers.robots}
    commanded = {robot for numbers in trials for robot in numbers.twists}
    if "" in commanded or not commanded or not posed:
        return set()
    commanded_names = join_names(commanded)
    if posed == {""}:
        if len(commanded) == 1:
            return set()
        raise UsageError(
            f"{trial_with_poses.poses_path}: the file has no column named robot, but the commands "
            f"are for the robots {commanded_names}",
            "add a column named robot that names the robot of each pose",
        )
    idle = posed - commanded
    if idle == posed:
        raise UsageError(
            f"{trial_with_poses.commands_path}: no command is for the robots {join_names(posed)}; "
            f"all commands are for {commanded_names}",
            "give each robot the same name in both files",
        )
    return idle


def _find_unseen_robots(trials: list[_TrialData]) -> set[str]:
    """Return the robots that have no complete pose (x, y, heading) in any of the trials."""
    seen = set[str]()
    for numbers in trials:
        rows = numbers.pose_rows()
        is_complete = np.isfinite(rows["pose"]).all(axis=1)
        seen_indices = set(rows["robot"][is_complete].tolist())
        seen.update(robot for robot, index in numbers.robots.items() if index in seen_indices)
    return {robot for numbers in trials for robot in numbers.robots} - seen


def _refuse_repeated_files(paths: list[Path]) -> None:
    """Check that no file is given twice, because its rows would count twice.

    Raises:
        UsageError: If a file is given twice.
    """
    seen_files = set[Path]()
    for path in paths:
        file = path.resolve()
        if file in seen_files:
            raise UsageError(f"{path}: this file is given twice", BOTH_FILES_HINT)
        seen_files.add(file)


def _find_columns(path: Path, headers: Mapping[str, str]) -> _TableColumns:
    """Find the columns of a file of poses or of commands, by its header.

    Raises:
        UsageError: If the file contains neither, or if a column has an unknown unit or none.
    """
    quantities_named = {split_header(header)[0] for header in headers}
    time_column = find_time(path, headers)
    columns_present: dict[str, int] = {}
    for kind, columns in TABLE_COLUMNS.items():
        quantities = dict(map(split_header, columns))
        columns_present[kind] = len(quantities_named & quantities.keys())
        if columns_present[kind] < len(columns) or time_column is None:
            continue
        if kind == POSES:
            unit, x, y = _find_position_columns(path, headers)
            heading = _get_column(path, headers, "heading", RADIANS)
            return _TableColumns(
                path, kind, time_column, {"x": x, "y": y, "heading": heading}, unit
            )
        by_name = {
            name: _get_column(path, headers, name, UNITS[unit]) for name, unit in quantities.items()
        }
        if kind == DIRECTIONS:
            for name in ("observed", "lag"):
                column = find_column(path, headers, (name,), SECONDS)
                if column is not None:
                    by_name[name] = column
        return _TableColumns(path, kind, time_column, by_name)
    raise _create_missing_columns_error(path, headers, columns_present)


def _create_missing_columns_error(
    path: Path, headers: Collection[str], columns_present: dict[str, int]
) -> UsageError:
    """Describe which columns a table lacks.

    The table is compared with the kind of table of which it has most columns. `columns_present` is
    the number of its columns by kind of table. If a column has a known quantity in an unknown unit,
    such as v_km_h, the message names it.
    """
    columns_found = ", ".join(printable(header) for header in list(headers)[:COLUMNS_SHOWN])
    likeliest_kind = max(reversed(columns_present), key=lambda kind: columns_present[kind])
    quantities_present = {split_header(header)[0] for header in headers}
    missing = [] if quantities_present & set(TIME_NAMES) else ["time_s"]
    missing += [
        column
        for column in TABLE_COLUMNS[likeliest_kind]
        if split_header(column)[0] not in quantities_present
    ]
    for header in headers:
        for column in missing:
            name, unit = split_header(column)
            if header.lower().startswith(f"{name}_"):
                units = ", ".join(UNITS.get(unit, SECONDS))
                return UsageError(
                    f"{path}: the unit of column {printable(header)} is none of {units}",
                    f"convert the values, and name the column {column}",
                )
    if not columns_present[likeliest_kind]:
        return UsageError(
            f"{path}: the file contains neither poses nor commands; its columns are "
            f"{columns_found}",
            FORMAT,
        )
    return UsageError(
        f"{path}: the file contains {likeliest_kind}, but lacks {' and '.join(missing)}; its "
        f"columns are {columns_found}",
        FORMAT,
    )


def _get_column(
    path: Path, headers: Collection[str], name: str, units: Mapping[str, float]
) -> NumberColumn:
    """Return the column for a name that the table is known to have, in any of these units.

    Raises:
        UsageError: If the column has another unit.
    """
    column = find_column(path, headers, (name,), units)
    assert column is not None
    return column


def _find_position_columns(
    path: Path, headers: Collection[str]
) -> tuple[str, NumberColumn, NumberColumn]:
    """Find the columns of x and y, and return their unit, x and y.

    Both must have the same unit, otherwise a `UsageError` is raised.
    """
    header_by_quantity = {split_header(header): header for header in headers}
    for unit in METRES:
        if ("x", unit) in header_by_quantity and ("y", unit) in header_by_quantity:
            return (
                unit,
                NumberColumn(header_by_quantity["x", unit]),
                NumberColumn(header_by_quantity["y", unit]),
            )
    raise UsageError(
        f"{path}: the file needs the columns x_mm and y_mm, or both in another "
        "unit, such as x_m and y_m"
    )


def _join_track(
    numbers: _TrialData, unit: str, name: Trial, idle: set[str], unseen: set[str]
) -> Track:
    """Join the numbers of a trial to one track of all its robots.

    Args:
        numbers: The numbers of the trial. In the track, times count from the first pose.
        unit: The unit of lengths.
        name: The log and the trial, as the rows of the tables name them.
        idle: Robots to leave out because they receive no command.
        unseen: Robots to leave out because they have no pose.

    Raises:
        UsageError: If a part is missing, or if parts contradict each other.
    """
    poses_path = numbers.poses_path
    commands_path = numbers.commands_path
    if poses_path is None or commands_path is None:
        raise UsageError(
            f"{poses_path or commands_path}: each trial needs a file of poses and a file of "
            "commands",
            BOTH_FILES_HINT,
        )
    rows = numbers.pose_rows()
    _refuse_two_places(poses_path, rows, list(numbers.robots))
    start_s = float(rows["time"].min())
    rows["time"] -= start_s
    index_by_robot = {robot: k for robot, k in numbers.robots.items() if robot not in idle | unseen}
    rows = rows[np.isin(rows["robot"], list(index_by_robot.values()))]
    if not index_by_robot:
        raise UsageError(f"{poses_path}: no robot was seen: every pose is empty")
    names = tuple(robot or DEFAULT_NAME for robot in index_by_robot)
    time_s, poses = _collect_frames(poses_path, rows, len(names))
    times_s_by_robot = [rows["time"][rows["robot"] == number] for number in index_by_robot.values()]
    _refuse_long_gaps(poses_path, start_s, times_s_by_robot)
    if numbers.twists:
        commands = _collect_twists(numbers, commands_path, list(index_by_robot), unit, start_s)
    else:
        commands = _collect_directions(numbers, commands_path, start_s)
    if not len(commands.sent_s):
        raise UsageError(f"{commands_path}: the file states no direction and no speed")
    if commands.end_s <= 0 or commands.sent_s[0] >= time_s[-1]:
        raise UsageError(
            f"{commands_path}: no command acts while the robots are seen. The commands run from "
            f"{start_s + commands.sent_s[0]:.12g} to {start_s + commands.sent_s[-1]:.12g} s, but "
            f"the poses in {poses_path} run from {start_s:.12g} to {start_s + time_s[-1]:.12g} s",
            "the times in both files must come from the same clock",
        )
    is_stated = np.asarray(np.isfinite(poses).all(axis=2))
    is_measured = _find_measurements(time_s, poses, is_stated)
    log, _ = name
    never_seen = (unseen - idle) & set(numbers.robots)
    if "" not in numbers.robots:
        never_seen |= set(numbers.twists) - set(numbers.robots) - {""}
    remarks: list[str] = []
    for robot, is_robot_stated, is_robot_measured in zip(
        names, is_stated.T, is_measured.T, strict=True
    ):
        left_out_fraction = 1 - is_robot_measured.sum() / max(is_robot_stated.sum(), 1)
        if left_out_fraction > LEFT_OUT_FRACTION_MAX:
            remarks.append(
                f"{poses_path}: {left_out_fraction:.1%} of the poses of {printable(robot)} were "
                "left out, because they repeat the previous pose, or jump away and back"
            )
    if idle & set(numbers.robots):
        remarks.append(
            f"{commands_path}: no command is for {join_names(idle & set(numbers.robots))}; all "
            f"commands are for {join_names(numbers.twists)}"
        )
    if never_seen:
        remarks.append(f"{poses_path}: the file has no pose of {join_names(never_seen)}")
    return Track(
        source=log or str(poses_path),
        origin=ORIGIN,
        unit=unit,
        names=names,
        time_s=time_s,
        poses=np.where(is_measured[..., None], poses, 0.0),
        valid=is_measured,
        sent_s=commands.sent_s,
        direction_rad=commands.u,
        stop_s=commands.end_s,
        frame_age_s=commands.frame_age,
        lag_s=numbers.lag_s,
        on_wheels=True,
        has_all_commands=numbers.lag_s == 0,
        rates_unstated=numbers.lag_s > 0 and not log,
        twists=commands.twists,
        has_two_clocks=not log,
        commands_source=str(commands_path),
        remarks=tuple(remarks),
    )


@dataclass(frozen=True, slots=True)
class _Commands:
    """The commands that were sent at the times `sent_s` (C,) [s].

    `u`, `twists` and `frame_age` have the same meaning as in `Track`.
    """

    sent_s: Floats
    u: Floats
    twists: Floats = field(default_factory=lambda: np.zeros((0, 0, 2)))
    frame_age: float | None = None

    @property
    def end_s(self) -> float:
        """Time at which the last command stops acting [s].

        The last command counts as long as the median time between two commands.
        """
        gaps_s = np.diff(self.sent_s)
        return float(self.sent_s[-1] + (np.median(gaps_s) if gaps_s.size else 0.0))


def join_names(robots: Collection[str]) -> str:
    """Join the names of robots for a message, sorted and separated by commas.

    An empty name is shown as "rows without a robot".
    """
    return ", ".join(printable(robot) or "rows without a robot" for robot in sorted(robots))


def _refuse_two_places(path: Path, rows: NDArray[np.void], names: list[str]) -> None:
    """Check that no robot is at two places at the same time.

    The POSE_ROWs (R,) belong to several robots. Two equal rows are allowed.

    Raises:
        UsageError: If a robot has two places at one time.
    """
    ordered = rows[np.lexsort((rows["time"], rows["robot"]))]
    earlier_rows = ordered[:-1]
    later_rows = ordered[1:]
    is_same_moment = (earlier_rows["time"] == later_rows["time"]) & (
        earlier_rows["robot"] == later_rows["robot"]
    )
    differs = np.abs(earlier_rows["pose"] - later_rows["pose"])[:, :2].max(axis=1) > 0
    conflicts = np.flatnonzero(is_same_moment & differs)
    if len(conflicts):
        conflict = later_rows[conflicts[0]]
        name = names[int(conflict["robot"])]
        hint = "does the file hold several robots, or are its times rounded?"
        if not name:
            hint = "if the file holds several robots, name them in a column named robot"
        raise UsageError(
            f"{path}: {printable(name or DEFAULT_NAME)} has two different places at "
            f"{conflict['time']:.15g} s",
            hint,
        )


def _refuse_long_gaps(path: Path, start_s: float, times_s_by_robot: Sequence[Floats]) -> None:
    """Check that the times of each robot's poses form one recording.

    Args:
        path: The file of the poses.
        start_s: The time from which times count [s].
        times_s_by_robot: The times of each robot's poses, in order [s].

    Raises:
        UsageError: If there is a pause of hours or days, or if the poses are too far apart.
    """
    gaps_s_by_robot = [np.diff(times) for times in times_s_by_robot if len(times) > 1]
    if not gaps_s_by_robot:
        return
    if max(gaps_s.max() for gaps_s in gaps_s_by_robot) > RECORDING_GAP_MAX_S:
        all_times_s = np.unique(np.concatenate(times_s_by_robot))
        longest_gap = int(np.diff(all_times_s).argmax())
        pause_ends_s = start_s + all_times_s[longest_gap : longest_gap + 2]
        raise UsageError(
            f"{path}: the file has no pose between {pause_ends_s[0]:.12g} and "
            f"{pause_ends_s[1]:.12g} s",
            "if the file holds two recordings, number them in a column named trial",
        )
    median_gap_s = min(float(np.median(gaps_s)) for gaps_s in gaps_s_by_robot)
    if median_gap_s > POSE_GAP_MAX_S:
        raise UsageError(
            f"{path}: successive poses of a robot are {median_gap_s:.3g} s apart",
            f"poses must be at most {POSE_GAP_MAX_S:g} s apart; is the time really in the unit "
            "that its column states?",
        )


def _collect_frames(path: Path, rows: NDArray[np.void], n_robots: int) -> tuple[Floats, Floats]:
    """Sort POSE_ROWs (R,) by time, and return times (M,) and poses (M, N, 3).

    Poses that are missing are NaN, and robots come in the order of their numbers. More than
    POSES_MAX poses are a `UsageError`.
    """
    _, robot_columns = np.unique(rows["robot"], return_inverse=True)
    time_s, frame_rows = np.unique(rows["time"], return_inverse=True)
    if len(time_s) * n_robots > POSES_MAX:
        amount = f"poses of {n_robots} robots at {len(time_s)} times"
        raise UsageError(
            f"{path}: the file has {amount} in one trial, but at most "
            f"{POSES_MAX} poses can be read from a trial"
        )
    poses = np.full((len(time_s), n_robots, 3), np.nan)
    poses[frame_rows, robot_columns] = rows["pose"]
    return time_s, poses


def _find_measurements(times_s: Floats, poses: Floats, is_stated: Bools) -> Bools:
    """Find which stated poses (M, N, 3) at times (M,) [s] are real measurements, shape (M, N)."""
    is_measured = np.zeros_like(is_stated)
    for robot in range(is_stated.shape[1]):
        rows = np.flatnonzero(is_stated[:, robot])
        is_measured[rows, robot] = measured(times_s[rows], poses[rows, robot])
    return is_measured


def _collect_directions(numbers: _TrialData, path: Path, start_s: float) -> _Commands:
    """Return the directions in order, with times counted from `start_s`.

    Raises:
        UsageError: If robots receive different directions.
    """
    rows = np.zeros(0, DIRECTION_ROW)
    for robot, robot_numbers in numbers.directions.items():
        previous_rows = rows
        rows = _view_as_rows(robot_numbers, DIRECTION_ROW)
        _refuse_two_commands(path, robot, rows["time"], rows["direction"][:, None])
        if len(previous_rows) and not np.array_equal(previous_rows["direction"], rows["direction"]):
            raise UsageError(
                f"{path}: {printable(robot)} does not receive the directions of the other robots",
                "all robots in one table must receive the same directions; if they do not, call "
                "identify once for each robot, with its tables alone",
            )
    ages_s = (rows["time"] - rows["observed"])[1:]
    ages_s = ages_s[np.isfinite(ages_s)]
    frame_age_s = max(0.0, float(np.median(ages_s))) if ages_s.size else None
    return _Commands(rows["time"] - start_s, rows["direction"].copy(), frame_age=frame_age_s)


def _collect_twists(
    numbers: _TrialData, path: Path, robots: list[str], unit: str, start_s: float
) -> _Commands:
    """Return the speeds and turning rates in order, with times counted from `start_s`.

    Speeds are in the unit of the poses.
    """
    rows_by_robot = {
        robot: _view_as_rows(robot_numbers, TWIST_ROW)
        for robot, robot_numbers in numbers.twists.items()
    }
    for robot, rows in rows_by_robot.items():
        twists = np.column_stack([rows["speed"], rows["turning_rate"]])
        _refuse_two_commands(path, robot, rows["time"], twists)
    rows_for_all = rows_by_robot.get("", np.zeros(0, TWIST_ROW))
    if robots == [""] and len(rows_by_robot) == 1:
        (rows_for_all,) = rows_by_robot.values()
    times_s = np.unique(np.concatenate([rows["time"] for rows in rows_by_robot.values()]))
    twists = np.full((len(times_s), len(robots), 2), np.nan)
    for i, robot in enumerate(robots):
        rows = rows_by_robot.get(robot, rows_for_all)
        command_rows = np.searchsorted(times_s, rows["time"])
        twists[command_rows, i, 0] = rows["speed"] / METRES[unit]
        twists[command_rows, i, 1] = rows["turning_rate"]
    return _Commands(times_s - start_s, np.full(len(times_s), np.nan), twists)


def _refuse_two_commands(path: Path, robot: str, times_s: Floats, commands: Floats) -> None:
    """Check that no robot receives two different commands (C, K) at the same time.

    This can happen if the times (C,) [s] are rounded.

    Raises:
        UsageError: If a robot receives two commands at one time.
    """
    differs = (np.diff(commands, axis=0) != 0).any(axis=1)
    conflicts = np.flatnonzero((np.diff(times_s) == 0) & differs)
    if len(conflicts):
        robot_name = printable(robot or DEFAULT_NAME)
        raise UsageError(
            f"{path}: {robot_name} is sent two different commands at the same time, "
            f"{times_s[conflicts[0]]:.15g} s",
            "the times of a robot's commands must increase from one to the next; are they rounded?",
        )

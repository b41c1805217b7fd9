"""Identifies robots from tracks: each value with its 95 % interval.

The values can be shown in tables, or written to a section of a spec:

    robots = identify(tracks, expected_a)
    robots = remove_unsure_intervals(robots)
    tables(robots), create_spec_section(robots, when)
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from tetractl.control.estimation.filter_start import SPEED_MIN
from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats
from tetractl.spec.identified import Identified, IdentifiedRobot, IdentifiedValue
from tetractl.tools.likelihood import SampleInterval
from tetractl.tools.table.table import Column, Table
from tetractl_identify.explained import (
    Explained,
    assign_windows,
    explain_steps,
    refuse_contradicted,
)
from tetractl_identify.fit import FittedRobot, fit
from tetractl_identify.passes import TrackFrames, compute_median_speeds, count_driving_intervals
from tetractl_identify.pose_steps import PoseSteps
from tetractl_identify.tracks import SETTLING_S, Track, require_same, select_rows_apart
from tetractl_identify.turn_samples import GAP_MIN_S, GAP_RATIO_MAX, TurnSamples
from tetractl_identify.unusual import describe_unusual_values
from tetractl_identify.wheel_lag import may_lag_explain_turns

INTERVALS_MIN = 20
"""Minimum number of intervals of a robot for a fit."""
STEP_S = 0.1
"""Minimum duration of the steps by which distances are compared [s]."""
DEFAULT_A = 3.0
"""Expected turning rate a if the log states no value [rad/s]."""
QUANTITIES = {
    "a": "rad/s",
    "speed": "{unit}/s",
    "heading_bias": "rad",
    "position_noise": "{unit}",
    "heading_noise": "rad",
    "heading_walk": "rad/sqrt(s)",
}
"""The fields of a robot in a table, with their units."""
UNIFORM_DEVIATION_MAX_RAD = 0.2
"""Maximum deviation of directions that turn uniformly [rad].

No direction is further from a straight line over time than this, nor from the previous direction.
Steps of .4 rad suffice to distinguish a from the dead time.
"""
TOTAL_TURN_MIN_RAD = 1.0
"""Minimum angle by which directions that turn uniformly turn in total [rad]."""
RATE_RATIO_MAX = 1.1
"""Maximum ratio of the turning rates of two tracks that count as one rate."""
ROBOTS_PER_TABLE = 3
"""Maximum number of robots in one table."""
DECIMALS_MAX = 6
DECIMALS_OF_EXACT = 3
"""Decimals of a value whose interval has no width, or no known end."""


class Doubt(Enum):
    """A reason why the intervals of a, heading bias and dead time cannot be trusted."""

    UNIFORM_TURNS = "all directions turn at one rate"
    RATES_UNSTATED = "a track has `rates_unstated`"
    LAG_UNSTATED = "wheels whose lag nothing states would explain turns"


@dataclass(frozen=True, slots=True)
class IdentifiedRobots:
    """The identified values of all robots.

    Attributes:
        origin: The plant of the logs.
        sources: Names of the logs or files.
        unit: The length unit.
        commands: Number of commands.
        dead_time: Time from the sending of a direction until it acts [s].
        frame_age: Median time from the exposure of a frame to the sending of the direction decided
            on it [s]. None if unknown.
        robots: The values of each robot.
        strength: Strength of the field, in `strength_unit`. None if the logs do not state it.
        strength_unit: Unit of `strength`.
        may_lag: Whether robots are on wheels whose lag nothing states and that would explain their
            turns.
        turns_uniformly: Whether all directions turn at one rate.
        rates_unstated: As in `Track`.
        turning_explained: How much of each robot's turning the directions explain.
        distance_explained: How much of each robot's distance travelled they explain.
    """

    origin: str
    sources: tuple[str, ...]
    unit: str
    commands: int
    dead_time: SampleInterval
    frame_age: float | None
    robots: tuple[FittedRobot, ...]
    strength: float | None = None
    strength_unit: str = "mT"
    may_lag: bool = False
    turns_uniformly: bool = False
    rates_unstated: bool = False
    turning_explained: tuple[Explained, ...] = ()
    distance_explained: tuple[Explained, ...] = ()

    @property
    def doubt(self) -> Doubt | None:
        """The first reason for doubt that applies. None if there is none."""
        if self.turns_uniformly:
            return Doubt.UNIFORM_TURNS
        if self.rates_unstated:
            return Doubt.RATES_UNSTATED
        return Doubt.LAG_UNSTATED if self.may_lag else None


def identify(
    tracks: list[Track], a: Floats | None, dead_time: float | None = 0.05
) -> IdentifiedRobots:
    """Identify robots from tracks. All tracks must show the same robots.

    Args:
        tracks: The tracks.
        a: Expected turning rates [rad/s], shape (N,), right within a factor of about 5. None if
            unknown.
        dead_time: Expected dead time [s], right within 0.3 s. None if unknown.

    Raises:
        UsageError: If the tracks contain too little data.
    """
    require_same(tracks)
    names = tracks[0].names
    frames = [TrackFrames.from_track(track) for track in tracks]

    # each robot must drive, and for long enough
    recorded_s = sum(float(np.ptp(track.time_s)) for track in tracks)
    for name, count in zip(names, count_driving_intervals(frames), strict=True):
        if count < INTERVALS_MIN:
            raise UsageError(
                f"robot {name} drives in only {count} intervals between frames, in a recording "
                f"of {recorded_s:.3g} s",
                f"at least {INTERVALS_MIN} intervals are needed: give more logs, or longer ones",
            )
    speed = compute_median_speeds(frames)
    if speed.min() < SPEED_MIN:
        standing_robot = names[int(np.argmin(speed))]
        raise UsageError(
            f"robot {standing_robot} does not move in these logs",
            "give logs in which every robot drives: the turning rate a shows only then",
        )

    expected_a = np.full(len(names), DEFAULT_A) if a is None else a
    all_commands = all(track.has_all_commands for track in tracks)
    shared_dead_time, robots = fit(frames, names, expected_a, speed, dead_time, all_commands)

    # what the user must know of the values
    turning_explained: list[Explained] = []
    distance_explained: list[Explained] = []
    problems: list[tuple[str, str]] = []
    for robot_index, robot in enumerate(robots):
        turning = _turning_explained(tracks, robot_index, robot, shared_dead_time.value)
        distance = _distance_explained(tracks, robot_index, robot)
        turning_explained.append(turning)
        distance_explained.append(distance)
        contradictions = [f"{turning} of the turning"] if turning.is_contradicted(True) else []
        if distance.is_contradicted(True):
            contradictions.append(f"{distance} of the distance travelled")
        if contradictions:
            problems.append((robot.name, " and ".join(contradictions)))
    sources = dict.fromkeys(source for track in tracks for source in track.sources)
    refuse_contradicted(tuple(sources), problems)
    no_lag_stated = any(track.on_wheels and track.lag_s == 0 for track in tracks)
    frame_ages_s = [track.frame_age_s for track in tracks if track.frame_age_s is not None]
    return IdentifiedRobots(
        origin=", ".join(dict.fromkeys(track.origin for track in tracks)),
        sources=tuple(track.source for track in tracks),
        unit=tracks[0].unit,
        commands=sum(len(track.direction_rad) for track in frames),
        dead_time=shared_dead_time,
        frame_age=float(np.median(frame_ages_s)) if frame_ages_s else None,
        robots=robots,
        strength=tracks[0].strength,
        strength_unit=tracks[0].strength_unit,
        may_lag=no_lag_stated and may_lag_explain_turns(tracks, shared_dead_time.value),
        turns_uniformly=is_turning_uniform(tracks),
        rates_unstated=any(track.rates_unstated for track in tracks),
        turning_explained=tuple(turning_explained),
        distance_explained=tuple(distance_explained),
    )


def _turning_explained(
    tracks: Sequence[Track], robot_index: int, robot: FittedRobot, dead_time_s: float
) -> Explained:
    """Compute how much of a robot's turning its fitted values explain.

    The prediction uses a dead time [s]. A direction asks for a turn as large as the change from the
    previous direction.
    """
    measured_angles: list[Floats] = []
    fitted_angles: list[Floats] = []
    asked_angles: list[Floats] = []
    begins_s: list[Floats] = []
    ends_s: list[Floats] = []
    for track in tracks:
        turns = TurnSamples.from_track(track, robot_index)
        asked_turns = turns.integrate_pull(track.lag_s, dead_time_s) * np.exp(
            1j * robot.heading_bias.value
        )
        measured_angles.append(turns.turn_rad)
        fitted_angles.append(robot.a.value * asked_turns.imag)
        directions_rad = np.unwrap(turns.direction_rad)
        directions_at_ends = [
            directions_rad[np.maximum(np.searchsorted(turns.sent_s, times - dead_time_s), 1) - 1]
            for times in (turns.begin_s, turns.end_s)
        ]
        asked_angles.append(directions_at_ends[1] - directions_at_ends[0])
        begins_s.append(turns.begin_s)
        ends_s.append(turns.end_s)
    return explain_steps(
        np.concatenate(measured_angles),
        np.concatenate(fitted_angles),
        np.concatenate(asked_angles),
        robot.heading_noise.value,
        assign_windows(np.concatenate(begins_s), np.concatenate(ends_s)),
    )


def _distance_explained(tracks: Sequence[Track], robot_index: int, robot: FittedRobot) -> Explained:
    """Compute how much of a robot's distance travelled its fitted speed explains.

    Only steps count in which the robot drives as commanded. Without any, the fraction is None.
    """
    steps_by_track: list[PoseSteps] = []
    begin_s: list[Floats] = []
    for track in tracks:
        times = track.exposed_s[:, robot_index]
        drives = (times >= track.sent_s[0] + SETTLING_S) & (times <= track.stop_s)
        rows = np.flatnonzero(drives & track.follows_commands[:, robot_index])
        rows = rows[select_rows_apart(times[rows], STEP_S)]
        if len(rows) > 1:
            steps_by_track.append(PoseSteps.from_poses(times[rows], track.poses[rows, robot_index]))
            begin_s.append(times[rows[:-1]])
    if not steps_by_track:
        return Explained(None, 0.0, 0.0)
    steps = PoseSteps.concatenate(steps_by_track)
    begins = np.concatenate(begin_s)
    is_seen = steps.duration_s < max(GAP_MIN_S, GAP_RATIO_MAX * float(np.median(steps.duration_s)))
    seen = steps.select(is_seen)
    fitted = robot.speed.value * seen.duration_s
    windows = assign_windows(begins[is_seen], begins[is_seen] + seen.duration_s)
    return explain_steps(seen.displacement, fitted, fitted, robot.position_noise.value, windows)


def is_turning_uniform(tracks: list[Track]) -> bool:
    """Check whether the directions of all tracks turn at one constant rate, to either side.

    Robots then follow the directions at a constant angle. The dead time, a and the heading bias all
    change this angle, so the data cannot separate them.
    """
    rates_rad_s: list[float] = []
    for track in tracks:
        directions_rad = np.unwrap(track.direction_rad)
        times_s = track.sent_s - track.sent_s[0]
        if (
            len(directions_rad) < 3
            or np.ptp(directions_rad) < TOTAL_TURN_MIN_RAD
            or not times_s.any()
        ):
            return False
        changes_rad = np.abs(np.diff(directions_rad))
        if changes_rad.max() > UNIFORM_DEVIATION_MAX_RAD:
            return False
        rate_rad_s, intercept_rad = np.polyfit(times_s, directions_rad, 1)
        if (
            np.abs(directions_rad - intercept_rad - rate_rad_s * times_s).max()
            > UNIFORM_DEVIATION_MAX_RAD
        ):
            return False
        rates_rad_s.append(abs(rate_rad_s))
    return max(rates_rad_s) < RATE_RATIO_MAX * min(rates_rad_s)


def remove_unsure_intervals(result: IdentifiedRobots) -> IdentifiedRobots:
    """Remove the intervals that cannot be trusted, for printing and for specs.

    An end of an interval is removed if the interval would hold in fewer than 92 % of the logs of
    trials (docs/how-to/identify.md).
    """
    unsure = ["heading_noise", "heading_walk"]
    dead_time = result.dead_time
    if result.doubt is not None:
        # all robots share the dead time: if it is wrong, a and bias of each are
        unsure += ["a", "heading_bias"]
        dead_time = _without_ends(dead_time)
    robots: list[FittedRobot] = []
    for robot in result.robots:
        values = {name: _without_ends(getattr(robot, name)) for name in unsure}
        robots.append(replace(robot, **values))
    return replace(result, dead_time=dead_time, robots=tuple(robots))


def _without_ends(interval: SampleInterval) -> SampleInterval:
    return SampleInterval(interval.value, math.nan, math.nan)


def create_spec_section(result: IdentifiedRobots, when: str) -> Identified:
    """Create the section `identified` of a spec. Its dead time is at least 0.

    `sent_s` is the date and time of the identification, as text.
    """
    value_and_ends_s = (result.dead_time.value, result.dead_time.low, result.dead_time.high)
    robots: dict[str, IdentifiedRobot] = {}
    for robot in result.robots:
        values = {name: _spec_value(getattr(robot, name)) for name in QUANTITIES}
        robots[robot.name] = IdentifiedRobot(**values)
    return Identified(
        identified=when,
        origin=result.origin,
        sources=result.sources,
        unit=result.unit,
        dead_time=_spec_value(SampleInterval(*np.maximum(value_and_ends_s, 0.0).tolist())),
        frame_age=result.frame_age or 0.0,
        strength=result.strength,
        robots=robots,
    )


def _spec_value(interval: SampleInterval) -> IdentifiedValue:
    """Create a value of the spec. An end of its interval that is NaN or infinite becomes None."""
    return IdentifiedValue(
        value=interval.value,
        low=interval.low if math.isfinite(interval.low) else None,
        high=interval.high if math.isfinite(interval.high) else None,
    )


_WHY_NO_INTERVALS = {
    None: "",
    Doubt.UNIFORM_TURNS: (
        "a, heading bias and dead time have no intervals, because all directions turn at one "
        "rate. With such directions, the three values cannot be distinguished. Record again with "
        "directions that jump"
    ),
    Doubt.RATES_UNSTATED: (
        "a, heading bias and dead time have no intervals, because the fit assumes that the host "
        "allows for the lag of the wheels, as it does in logs and exports. If the robots steer "
        "themselves instead, a may be wrong by 40 %"
    ),
    Doubt.LAG_UNSTATED: (
        "a, heading bias and dead time have no intervals, because the lag of the wheels is "
        "unknown. Wheels with a lag, or a host that sees headings late, would explain the turns "
        "as well or better, and the dead time would then contain this lag. State the lag (lag_s "
        "in a table, wheels.lag or lab.lag in a spec), or measure it with --wheels, or record "
        "with directions that jump, which can show that there is no lag"
    ),
}


def tables(result: IdentifiedRobots) -> list[Table]:
    """Create tables of all values with 95 % intervals: a row per value, a column per robot.

    Each table has at most ROBOTS_PER_TABLE robots. All tables have the same title and notes.
    """
    logs = "1 log" if len(result.sources) == 1 else f"{len(result.sources)} logs"
    title = f"{logs}, {result.commands} directions: {result.origin}; 95 % intervals"
    dead_time = f"dead time after a direction is sent: {cell(result.dead_time)} s"
    if result.frame_age is not None:
        dead_time += f"; frames are {result.frame_age:.4f} s old when a direction is sent"
    notes = [
        dead_time,
        _fit_text(result.robots),
        _WHY_NO_INTERVALS[result.doubt],
        describe_unusual_values(
            [
                ("all robots", {"dead_time": result.dead_time}),
                *(
                    (robot.name, {"a": robot.a, "heading_bias": robot.heading_bias})
                    for robot in result.robots
                ),
            ]
        ),
    ]
    note = "\n".join(line for line in notes if line)
    labels = [
        *create_row_labels(QUANTITIES, result.unit),
        "lost",
        "turning explained",
        "distance explained",
    ]
    if result.strength is not None:
        labels.append(f"a per strength [rad/(s {result.strength_unit})]")
    tables_of_robots: list[Table] = []
    for first_robot in range(0, len(result.robots), ROBOTS_PER_TABLE):
        columns = [
            Column(result.robots[robot_index].name, _entries(result, robot_index))
            for robot_index in range(
                first_robot, min(first_robot + ROBOTS_PER_TABLE, len(result.robots))
            )
        ]
        tables_of_robots.append(Table(title, (Column("quantity", labels), *columns), note))
    return tables_of_robots


def create_row_labels(quantities: Mapping[str, str], unit: str) -> list[str]:
    """Create the labels of a table's rows from quantities and their units.

    The text {unit} in a unit stands for the length unit.
    """
    labels: list[str] = []
    for name, value_unit in quantities.items():
        unit_suffix = f" [{value_unit.format(unit=unit)}]" if value_unit else ""
        labels.append(f"{name.replace('_', ' ')}{unit_suffix}")
    return labels


def _entries(result: IdentifiedRobots, robot_index: int) -> list[str]:
    """Create the entries of one robot's column, in the order of the labels of `tables`.

    The last entry is alpha, the turning rate per unit of the field's strength.
    """
    robot = result.robots[robot_index]
    cells = [cell(getattr(robot, name)) for name in QUANTITIES]
    cells.append(str(robot.lost))
    if result.turning_explained:
        cells += [
            str(result.turning_explained[robot_index]),
            str(result.distance_explained[robot_index]),
        ]
    else:
        cells += ["-", "-"]
    if result.strength is not None:
        strength = result.strength or math.nan
        a_per_strength = SampleInterval(
            robot.a.value / strength, robot.a.low / strength, robot.a.high / strength
        )
        cells.append(cell(a_per_strength))
    return cells


def _fit_text(robots: Sequence[FittedRobot]) -> str:
    """Describe in words whether the model fits, and name each robot that it does not fit."""
    misfits = [f"{robot.name} ({', '.join(robot.misfits)})" for robot in robots if robot.misfits]
    if not misfits:
        return "the model fits"
    return (
        f"the model does not fit {'; '.join(misfits)}: the speed or the turning of these robots "
        "varies within seconds"
    )


def cell(interval: SampleInterval) -> str:
    """Format a value and its interval for a table, as "value (low to high)".

    Both are rounded to two significant digits of half the interval's width. An infinite end is
    shown as "?", and the interval is left out if its lower end is NaN.
    """
    if math.isnan(interval.low):  # not stated; infinite if the data do not bound the value
        return f"{interval.value:.2g}"
    ends = (interval.low, interval.high)
    half_width = max((abs(end - interval.value) for end in ends if math.isfinite(end)), default=0.0)
    decimals = DECIMALS_OF_EXACT
    if half_width > 0:
        first_digit = math.floor(math.log10(half_width))
        decimals = min(max(1 - first_digit, 0), DECIMALS_MAX)
    low_text, high_text = (f"{end:.{decimals}f}" if math.isfinite(end) else "?" for end in ends)
    return f"{interval.value:.{decimals}f} ({low_text} to {high_text})"

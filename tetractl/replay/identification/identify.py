"""Identifies robots from tracks, and returns each value with its 95 % interval: as tables, and as a
section of a spec.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats
from tetractl.core.table.table import Column, Table
from tetractl.experiment.identified import Identified, IdentifiedRobot, IdentifiedValue
from tetractl.replay.identification.fit import HEADING, SampleInterval, fit
from tetractl.replay.identification.passes import TrackFrames, speeds
from tetractl.replay.identification.tracks import Track, require_same

INTERVALS_MIN = 20  # least number of intervals of a robot for a fit
UNKNOWN_A = 3.0  # prior a if the log states no value [rad/s]


@dataclass(frozen=True, slots=True)
class RobotFound:
    """The identified values of one robot; lengths in the tracks' unit.

    `a` [rad/s], `speed` [length unit/s], `heading_bias` [rad] as in `core.plan.Estimate`;
    `heading_noise` [rad] is the standard deviation of measured headings, `position_noise` [length
    unit] that of measured positions along the path. `heading_walk` [rad/sqrt(s)] is the standard
    deviation after one second of the heading's random walk. `lost` is the number of commands that
    the robot probably lost, `intervals` the number of intervals used. `misfits` names the residuals
    that the model does not explain.
    """

    name: str
    a: SampleInterval
    speed: SampleInterval
    heading_bias: SampleInterval
    position_noise: SampleInterval
    heading_noise: SampleInterval
    heading_walk: SampleInterval
    lost: int
    intervals: int
    misfits: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class IdentifiedRobots:
    """The identified values of all robots.

    `dead_time` [s] counts from the sending of a direction; `frame_age` [s] is the median time from
    the exposure of a frame to the sending of the direction decided on it, None if unknown.
    `strength` is that of the field in `strength_unit`, None if the logs do not state it.
    `lag_unstated` says that robots are on wheels whose lag nothing states.
    """

    origin: str
    sources: tuple[str, ...]
    unit: str
    commands: int
    dead_time: SampleInterval
    frame_age: float | None
    robots: tuple[RobotFound, ...]
    strength: float | None = None
    strength_unit: str = "mT"
    lag_unstated: bool = False


def identify(
    tracks: list[Track], a: Floats | None, dead_time: float | None = 0.05
) -> IdentifiedRobots:
    """Identify robots from tracks, all of the same robots.

    `a` (N,) [rad/s] are the expected turning rates, right within a factor of about 5, or None if
    unknown; `dead_time` [s] is the expected dead time, right within 0.3 s, or None. UsageError if
    the tracks contain too few data, or times of two clocks.
    """
    require_same(tracks)
    frames = [TrackFrames.of(track) for track in tracks]
    counts = np.sum([one.used.sum(axis=0) for one in frames], axis=0)
    for name, count in zip(tracks[0].names, counts, strict=True):
        if count < INTERVALS_MIN:
            raise UsageError(
                f"robot {name} drives in only {count} intervals between frames",
                f"{INTERVALS_MIN} intervals are needed; give more logs, or longer ones",
            )
    expected = np.full(len(counts), UNKNOWN_A) if a is None else a
    speed = speeds(frames)
    if not speed.all():
        still = tracks[0].names[int(np.argmin(speed))]
        raise UsageError(f"robot {still} does not move", "a is found of robots that drive")
    fitted = fit(frames, expected, speed, dead_time)
    ages = [track.frame_age for track in tracks if track.frame_age is not None]
    return IdentifiedRobots(
        origin=", ".join(dict.fromkeys(track.origin for track in tracks)),
        sources=tuple(track.source for track in tracks),
        unit=tracks[0].unit,
        commands=sum(len(one.u) for one in frames),
        dead_time=fitted.dead_time,
        frame_age=float(np.median(ages)) if ages else None,
        robots=tuple(
            RobotFound(
                name,
                *fitted.motion[i],
                position_noise=fitted.noise[i][0],
                heading_noise=fitted.noise[i][2],
                heading_walk=fitted.noise[i][3],
                lost=round(float(fitted.lost[i])),
                intervals=int(counts[i]),
                misfits=tuple(fitted.misfits[i]),
            )
            for i, name in enumerate(tracks[0].names)
        ),
        strength=tracks[0].strength,
        strength_unit=tracks[0].strength_unit,
        lag_unstated=any(track.on_wheels and track.lag == 0 for track in tracks),
    )


QUANTITIES = {
    "a": "rad/s",
    "speed": "{unit}/s",
    "heading_bias": "rad",
    "position_noise": "{unit}",
    "heading_noise": "rad",
    "heading_walk": "rad/sqrt(s)",
}
"""The fields of a robot in a table, with their units."""
UNSTATED = ("heading_noise", "heading_walk")
"""Those whose intervals are not stated."""
OF_HEADING = ("a", "heading_bias")
"""Those that the equation of the heading gives, with the dead time of all robots."""
NO_INTERVAL = (
    "a, heading bias and dead time have no intervals, as a lag of wheels may make them wrong: "
    "state it, lag_s in a table, wheels.lag or lab.lag in a spec, or measure it with --wheels"
)
_ABREAST = 3  # largest number of robots in one table
DECIMALS_MAX = 6  # decimals


def stated(found: IdentifiedRobots) -> IdentifiedRobots:
    """Return the values as they are printed and written: without the ends of intervals that hold in
    fewer than 92 % of the logs of trials (docs/how-to/identify.md). A lag of wheels that nothing
    states gives the dead time wrong, which all robots share, and with it a and the bias of each.
    """
    if not _may_lag(found):
        return replace(found, robots=tuple(_without(robot, UNSTATED) for robot in found.robots))
    robots = tuple(_without(robot, (*UNSTATED, *OF_HEADING)) for robot in found.robots)
    return replace(found, dead_time=_bare(found.dead_time), robots=robots)


def _without(robot: RobotFound, names: tuple[str, ...]) -> RobotFound:
    """Return a robot without the intervals of some values."""
    return replace(robot, **{name: _bare(getattr(robot, name)) for name in names})


def _bare(interval: SampleInterval) -> SampleInterval:
    """Return a value without the ends of its interval."""
    return SampleInterval(interval.value, math.nan, math.nan)


def _may_lag(found: IdentifiedRobots) -> bool:
    """Return whether wheels may have a lag that nothing states: a heading does not fit without."""
    return found.lag_unstated and any(HEADING in robot.misfits for robot in found.robots)


def identified(found: IdentifiedRobots, when: str) -> Identified:
    """Return the section `identified` of a spec; `when` is its date and time as text."""
    return Identified(
        identified=when,
        origin=found.origin,
        sources=found.sources,
        unit=found.unit,
        dead_time=_value(found.dead_time),
        frame_age=found.frame_age or 0.0,
        strength=found.strength,
        robots={
            robot.name: IdentifiedRobot(**{q: _value(getattr(robot, q)) for q in QUANTITIES})
            for robot in found.robots
        },
    )


def tables(found: IdentifiedRobots) -> list[Table]:
    """Return tables of each value with its 95 % interval; a row per value, a column per robot."""
    logs = "1 log" if len(found.sources) == 1 else f"{len(found.sources)} logs"
    age = "" if found.frame_age is None else f"; frames are {found.frame_age:.4f} s old at sending"
    labels = [
        f"{name.replace('_', ' ')} [{unit.format(unit=found.unit)}]"
        for name, unit in QUANTITIES.items()
    ]
    alpha = [] if found.strength is None else [f"a per strength [rad/(s {found.strength_unit})]"]
    parts = [found.robots[i : i + _ABREAST] for i in range(0, len(found.robots), _ABREAST)]
    return [
        Table(
            f"{logs}, {found.commands} directions: {found.origin}; 95 % intervals",
            (
                Column("quantity", [*labels, "lost", *alpha]),
                *(
                    Column(
                        robot.name,
                        [
                            *(cell(getattr(robot, name)) for name in QUANTITIES),
                            str(robot.lost),
                            *(cell(_per(robot.a, found.strength)) for _ in alpha),
                        ],
                    )
                    for robot in robots
                ),
            ),
            f"dead time from sending: {cell(found.dead_time)} s{age}\n{_fits(found)}",
        )
        for robots in parts
    ]


def _per(interval: SampleInterval, strength: float | None) -> SampleInterval:
    """Return alpha, the turning rate per unit of the field's strength."""
    by = strength or math.nan
    return SampleInterval(interval.value / by, interval.low / by, interval.high / by)


def _fits(found: IdentifiedRobots) -> str:
    """Return whether the model fits, as text."""
    misfits = [f"{one.name} ({', '.join(one.misfits)})" for one in found.robots if one.misfits]
    if not misfits:
        return "the model fits: residuals are not correlated in time"
    text = f"the model does not fit {'; '.join(misfits)}: residuals are correlated in time"
    if _may_lag(found):
        text += f"\n{NO_INTERVAL}"
    return text


def cell(interval: SampleInterval) -> str:
    """Return a value and the ends of its interval as text, rounded to two significant digits of
    half the interval's width.
    """
    if math.isnan(interval.low):  # not stated; infinite if the data do not bound the value
        return f"{interval.value:.2g}"
    ends = [one for one in (interval.low, interval.high) if math.isfinite(one)]
    width = max((abs(one - interval.value) for one in ends), default=0.0)
    digits = 3 if width <= 0 else min(max(1 - math.floor(math.log10(width)), 0), DECIMALS_MAX)
    low, high = (
        f"{one:.{digits}f}" if math.isfinite(one) else "?" for one in (interval.low, interval.high)
    )
    return f"{interval.value:.{digits}f} ({low} to {high})"


def _value(interval: SampleInterval) -> IdentifiedValue:
    low, high = (one if math.isfinite(one) else None for one in (interval.low, interval.high))
    return IdentifiedValue(value=interval.value, low=low, high=high)

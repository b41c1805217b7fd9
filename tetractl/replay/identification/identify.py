"""Identifies robots from tracks, and returns each value with its 95 % interval: as tables, and as a
section of a spec.
"""

import math
from dataclasses import dataclass

import numpy as np

from tetractl.control.prior import Prior
from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats
from tetractl.core.table.table import Column, Table
from tetractl.experiment.identified import Identified, IdentifiedRobot, IdentifiedValue
from tetractl.replay.identification.chain import Chain, ChainNoise, SampleInterval
from tetractl.replay.identification.fit import OUTLYING, Fitted, fit
from tetractl.replay.identification.tracks import Drives, Track, drives_of
from tetractl.replay.identification.turning import Turning

LEAST = 20  # least number of intervals of a robot for a fit
SPEED_ROUNDS = 3
DEAD_TIME_STD = 0.1  # prior standard deviation of the dead time [s]
# prior standard deviations of a (relative), speed (relative) and heading bias [rad]
A_STD, SPEED_STD, HEADING_BIAS_STD = 0.5, 0.5, 0.2
UNKNOWN_A = 3.0  # prior a if the log states no value [rad/s]


@dataclass(frozen=True, slots=True)
class RobotFound:
    """The identified values of one robot; lengths in the tracks' unit.

    `a` [rad/s], `speed` [length unit/s], `heading_bias` [rad] as in `core.plan.Estimate`;
    `heading_noise` [rad] is the standard deviation of measured headings, `position_noise` [length
    unit] that of measured positions along the path. `heading_walk` [rad/sqrt(s)] is the standard
    deviation after one second of the heading's random walk. `lost` is the number of commands that
    the robot probably lost, `intervals` the number of intervals used.
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


@dataclass(frozen=True, slots=True)
class IdentifiedRobots:
    """The identified values of all robots.

    `dead_time` [s] counts from the sending of a direction; `frame_age` [s] is the median time from
    the exposure of a frame to the sending of the direction decided on it, None if unknown.
    """

    origin: str
    sources: tuple[str, ...]
    unit: str
    commands: int
    dead_time: SampleInterval
    frame_age: float | None
    robots: tuple[RobotFound, ...]


def identify(tracks: list[Track], a: Floats | None, dead_time: float = 0.05) -> IdentifiedRobots:
    """Identify robots from tracks, all of the same robots.

    `a` (N,) [rad/s] are the expected turning rates, right within a factor of about 5, or None if
    unknown; `dead_time` [s] is the expected dead time, right within 0.3 s. UsageError if the tracks
    contain too few data.
    """
    drives = drives_of(tracks)
    counts = drives.intervals.usable.sum(axis=0)
    for name, count in zip(tracks[0].names, counts, strict=True):
        if count < LEAST:
            raise UsageError(
                f"robot {name} drives in only {count} intervals between frames",
                f"{LEAST} intervals are needed; `tetractl design` proposes a motion",
            )
    fitted = fit(tracks, drives, _prior(drives, a, dead_time))
    missed, by = fitted.turns.missed(fitted.best), fitted.turns.derivatives(fitted.best)
    robots = []
    for i, name in enumerate(tracks[0].names):
        speed, position = _speed(drives, fitted, i)
        of_heading, of_walk = fitted.chains[i].noise_intervals(
            missed[:, i], by[:, i], fitted.noises[i]
        )
        robots.append(
            RobotFound(
                name=name,
                a=SampleInterval(*(float(np.exp(p.ln_a[i])) for p in _three(fitted))),
                speed=speed,
                heading_bias=SampleInterval(*(float(p.beta[i]) for p in _three(fitted))),
                position_noise=position,
                heading_noise=SampleInterval(fitted.noises[i].measured, *of_heading),
                heading_walk=SampleInterval(fitted.noises[i].walk, *of_walk),
                lost=round(float(fitted.turns.lost[:, i].sum())),
                intervals=int(fitted.used[:, i].sum()),
            )
        )
    ages = [track.frame_age for track in tracks if track.frame_age is not None]
    return IdentifiedRobots(
        origin=", ".join(dict.fromkeys(track.origin for track in tracks)),
        sources=tuple(track.source for track in tracks),
        unit=tracks[0].unit,
        commands=len(drives.directions.u),
        dead_time=SampleInterval(*(p.tau for p in _three(fitted))),
        frame_age=float(np.median(ages)) if ages else None,
        robots=tuple(robots),
    )


def _three(fitted: Fitted) -> tuple[Turning, Turning, Turning]:
    return fitted.best, fitted.low, fitted.high


def _prior(drives: Drives, a: Floats | None, dead_time: float) -> Prior:
    intervals = drives.intervals
    pace = np.where(intervals.usable, intervals.travelled / drives.seconds[:, None], np.nan)
    return Prior(
        a=np.full(pace.shape[1], UNKNOWN_A) if a is None else a,
        speed=np.nanmedian(pace, axis=0),
        dead_time=dead_time,
        a_std=A_STD,
        speed_std=SPEED_STD,
        dead_time_std=DEAD_TIME_STD,
        heading_bias_std=HEADING_BIAS_STD,
    )


def _speed(drives: Drives, fitted: Fitted, robot: int) -> tuple[SampleInterval, SampleInterval]:
    """Return a robot's speed and position noise, from its displacements along the predicted path.
    An interval's displacement is speed times the predicted length per unit of speed, plus the
    camera's noise at its ends and a random walk.
    """
    x, y, _ = (column[:, robot] for column in fitted.turns.motion(fitted.best))
    length = np.hypot(x, y)
    # heading noise shortens the mean displacement by this factor
    shown = np.exp(-(fitted.noises[robot].measured ** 2) / 2)
    usable = drives.intervals.usable[:, robot] & (length > 0)
    way = np.column_stack([x, y]) / (length + 1e-300)[:, None]
    length = shown * length
    coupling = np.append(1.0, (way[1:] * way[:-1]).sum(axis=1))
    along = (drives.moved[:, robot] * way).sum(axis=1)
    speed = float(np.median(along[usable] / length[usable]))
    used, noise, chain, std = usable, ChainNoise(0.0, 1.0), None, np.inf
    for _ in range(SPEED_ROUNDS):
        r = along - speed * length
        if chain is None:
            deviation = float(np.median(np.abs(r[used]))) / 0.6745 + 1e-9
        else:
            deviation = np.sqrt(2 * noise.measured**2 + noise.walk**2 * drives.seconds)
        used = usable & (np.abs(r) <= OUTLYING * deviation + 1e-9)
        chain = Chain(drives.seconds, np.ones_like(length), used, drives.after, coupling)
        noise = chain.noise_of(r, length[:, None])
        y, by = chain.whiten(chain.factor(noise), np.column_stack([along, length])).T
        speed, std = float(by @ y / (by @ by)), float(1 / np.sqrt(by @ by))
    assert chain is not None
    of_position, _ = chain.noise_intervals(along - speed * length, length[:, None], noise)
    # the deviance is a parabola in the speed, so the profile interval is the normal one
    interval = SampleInterval(speed, speed - 1.96 * std, speed + 1.96 * std)
    return interval, SampleInterval(noise.measured, *of_position)


QUANTITIES = {
    "a": "rad/s",
    "speed": "{unit}/s",
    "heading_bias": "rad",
    "position_noise": "{unit}",
    "heading_noise": "rad",
    "heading_walk": "rad/sqrt(s)",
}
"""The fields of a robot in a table, with their units."""
_ABREAST = 3  # largest number of robots in one table
MOST = 6  # decimals


def identified(found: IdentifiedRobots, when: str) -> Identified:
    """Return the section `identified` of a spec; `when` is its date and time as text."""
    return Identified(
        identified=when,
        origin=found.origin,
        sources=found.sources,
        unit=found.unit,
        dead_time=_value(found.dead_time),
        frame_age=found.frame_age or 0.0,
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
    parts = [found.robots[i : i + _ABREAST] for i in range(0, len(found.robots), _ABREAST)]
    return [
        Table(
            f"{logs}, {found.commands} directions: {found.origin}; 95 % intervals",
            (
                Column("quantity", [*labels, "lost"]),
                *(
                    Column(
                        robot.name,
                        [*(cell(getattr(robot, name)) for name in QUANTITIES), str(robot.lost)],
                    )
                    for robot in robots
                ),
            ),
            f"dead time from sending: {cell(found.dead_time)} s{age}",
        )
        for robots in parts
    ]


def cell(interval: SampleInterval) -> str:
    """Return a value and the ends of its interval as text, rounded to two significant digits of
    half the interval's width.
    """
    ends = [one for one in (interval.low, interval.high) if math.isfinite(one)]
    width = max((abs(one - interval.value) for one in ends), default=0.0)
    digits = 3 if width <= 0 else min(max(1 - math.floor(math.log10(width)), 0), MOST)
    low, high = (
        f"{one:.{digits}f}" if math.isfinite(one) else "?" for one in (interval.low, interval.high)
    )
    return f"{interval.value:.{digits}f} ({low} to {high})"


def _value(interval: SampleInterval) -> IdentifiedValue:
    low, high = (one if math.isfinite(one) else None for one in (interval.low, interval.high))
    return IdentifiedValue(value=interval.value, low=low, high=high)

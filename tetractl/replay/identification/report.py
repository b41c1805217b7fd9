"""Writes identified values as a file for specs and as a table."""

import math

from tetractl.core.table.table import Column, Table
from tetractl.experiment.identified import Identified, IdentifiedRobot, IdentifiedValue
from tetractl.replay.identification.chain import SampleInterval
from tetractl.replay.identification.identify import IdentifiedRobots

QUANTITIES = {
    "a": "rad/s",
    "speed": "{unit}/s",
    "heading_bias": "rad",
    "position_noise": "{unit}",
    "heading_noise": "rad",
    "heading_walk": "rad/sqrt(s)",
}
"""The fields of a robot in a table, with their units."""
_ABREAST = 3  # robots in one table
MOST = 6  # decimals


def identified(found: IdentifiedRobots, when: str) -> Identified:
    """Return the `Identified` section; `when` is a time in words."""
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
    """Return each value with its 95 % interval, a column per robot."""
    logs = "1 log" if len(found.sources) == 1 else f"{len(found.sources)} logs"
    since = "" if found.frame_age is None else f"; its frame is {found.frame_age:.4f} s older"
    parts = [found.robots[i : i + _ABREAST] for i in range(0, len(found.robots), _ABREAST)]
    return [
        Table(
            f"{logs}, {found.commands} directions: {found.origin}; 95 % intervals",
            (
                Column("quantity", [_label(name, found.unit) for name in QUANTITIES] + ["lost"]),
                *(
                    Column(
                        robot.name,
                        [*(cell(getattr(robot, name)) for name in QUANTITIES), str(robot.lost)],
                    )
                    for robot in robots
                ),
            ),
            f"dead time from sending: {cell(found.dead_time)} s{since}",
        )
        for robots in parts
    ]


def _label(name: str, unit: str) -> str:
    return f"{name.replace('_', ' ')} [{QUANTITIES[name].format(unit=unit)}]"


def cell(interval: SampleInterval) -> str:
    """Return a value and the ends of its interval, with the digits that the interval leaves."""
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

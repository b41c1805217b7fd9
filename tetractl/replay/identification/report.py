"""What was identified, as a file for specs, as JSON, and as the cells of a table."""

import math
from dataclasses import asdict
from typing import Any

from tetractl.experiment.identified import Identified, IdentifiedRobot, Value
from tetractl.replay.identification.chain import Interval
from tetractl.replay.identification.identify import Found

HEADER = (
    "robot",
    "a [rad/s]",
    "speed [{unit}/s]",
    "heading bias [rad]",
    "track radius [{unit}]",
    "position noise [{unit}]",
    "heading noise [rad]",
    "heading walk [rad/sqrt(s)]",
    "lost",
)
QUANTITIES = (
    "a",
    "speed",
    "heading_bias",
    "track_radius",
    "position_noise",
    "heading_noise",
    "heading_walk",
)


def identified(found: Found, when: str) -> Identified:
    """Return what `Identified` holds of it; `when` is a time in words."""
    return Identified(
        identified=when,
        origin=found.origin,
        sources=found.sources,
        unit=found.unit,
        dead_time=_value(found.dead_time),
        frame_age=found.frame_age or 0.0,
        robots={
            robot.name: IdentifiedRobot(
                a=_value(robot.a),
                speed=_value(robot.speed),
                heading_bias=_value(robot.heading_bias),
                track_radius=None if robot.track_radius is None else _value(robot.track_radius),
                position_noise=_value(robot.position_noise),
                heading_noise=_value(robot.heading_noise),
                heading_walk=_value(robot.heading_walk),
            )
            for robot in found.robots
        },
    )


def as_json(found: Found) -> dict[str, Any]:
    """Return it as plain data; an end of an interval that is not known is null."""
    plain: dict[str, Any] = _finite(asdict(found))
    return plain


def rows(found: Found) -> list[list[str]]:
    """Return the cells of HEADER, a row a robot."""
    return [
        [robot.name, *(cell(getattr(robot, name)) for name in QUANTITIES), str(robot.lost)]
        for robot in found.robots
    ]


def cell(interval: Interval | None) -> str:
    """Return a value and the ends of its interval, with the digits that the interval leaves."""
    if interval is None:
        return "-"
    ends = [one for one in (interval.low, interval.high) if math.isfinite(one)]
    width = max((abs(one - interval.value) for one in ends), default=0.0)
    digits = 3 if width <= 0 else min(max(1 - math.floor(math.log10(width)), 0), 9)
    low, high = (
        f"{one:.{digits}f}" if math.isfinite(one) else "?" for one in (interval.low, interval.high)
    )
    return f"{interval.value:.{digits}f} ({low} to {high})"


def _value(interval: Interval) -> Value:
    low, high = (one if math.isfinite(one) else None for one in (interval.low, interval.high))
    return Value(value=interval.value, low=low, high=high)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

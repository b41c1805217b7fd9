"""Describes fitted values that are unusual, or that the data do not determine.

Values are always printed as they are. A sentence names the unusual ones, without a cause.
"""

import math
from collections.abc import Mapping, Sequence

from tetractl.core.errors import printable
from tetractl.tools.likelihood import SampleInterval
from tetractl_identify.explained import CHECKLIST

USUAL_RANGES = {
    "dead_time": (0.0, 0.6),
    "a": (0.05, 50.0),
    "turning_gain": (0.5, 2.0),
    "speed_gain": (0.5, 2.0),
    "heading_bias": (-math.pi / 4, math.pi / 4),
    "heading_offset": (-0.2, 0.2),
}
"""Usual ranges of values, in the units of the tables."""
GAINS = ("turning_gain", "speed_gain")
HALF_WIDTH_MAX = {"dead_time": 0.3, "turning_gain": 0.5, "speed_gain": 0.5}
"""Half width of an interval above which the data do not determine the value.

It is multiplied by the value if that is above 1.
"""

ValueByName = Mapping[str, SampleInterval]


def is_determined(name: str, value: SampleInterval) -> bool:
    """Check whether the data determine a value.

    Its interval must have two finite ends that are not too far apart. A value whose
    interval is not stated, with NaN as its ends, counts as determined.
    """
    if math.isnan(value.low):
        return True  # its interval is not stated
    half_width = max(value.high - value.value, value.value - value.low)
    half_width_max = HALF_WIDTH_MAX.get(name, math.inf) * max(1.0, abs(value.value))
    return half_width <= half_width_max and math.isfinite(half_width)


def may_be_usual(name: str, value: SampleInterval) -> bool:
    """Check whether the interval of a value overlaps the range of usual values for this name."""
    return _overlaps(value, *USUAL_RANGES[name])


def _overlaps(value: SampleInterval, lower: float, upper: float) -> bool:
    """Check whether the interval of a value overlaps a range. Ends that touch count as overlap."""
    return value.low <= upper and value.high >= lower


def _is_unusual(name: str, value: SampleInterval, lower: float, upper: float) -> bool:
    """Check whether a value's whole interval is outside a range.

    For gains, and for values without an interval, the value itself decides.
    """
    if name in GAINS or math.isnan(value.low):
        return not lower <= value.value <= upper
    return value.high < lower or value.low > upper


def describe_unusual_values(
    values_by_robot: Sequence[tuple[str, ValueByName]],
    usual_range_by_name: Mapping[str, tuple[float, float]] = USUAL_RANGES,
) -> str:
    """Describe in one sentence the values outside their usual ranges. Empty if there are none.

    Args:
        values_by_robot: The name of each robot, and its values by their names.
        usual_range_by_name: The usual range of each value, by the value's name.
    """
    sentences: list[str] = []
    for name, values in values_by_robot:
        for quantity, (lower, upper) in usual_range_by_name.items():
            value = values.get(quantity)
            if value is None or not _is_unusual(quantity, value, lower, upper):
                continue
            if _overlaps(value, lower, upper) and not is_determined(quantity, value):
                continue  # it may as well be usual
            sentence = f"the {quantity.replace('_', ' ')} of {printable(name)} is {value.value:.3g}"
            sentences.append(f"{sentence} (usual: {lower:.3g} to {upper:.3g})")
    return f"{'; '.join(sentences)}: {CHECKLIST}" if sentences else ""


def describe_undetermined_values(
    values_by_robot: Sequence[tuple[str, ValueByName]], names: Sequence[str]
) -> str:
    """Describe in one sentence the values that the data do not determine. Empty if there are none.

    Args:
        values_by_robot: The name of each robot, and its values by their names.
        names: The names of the values to check.
    """
    clauses: list[str] = []
    for robot, values in values_by_robot:
        undetermined = [name for name in names if not is_determined(name, values[name])]
        if undetermined:
            listed = ", ".join(name.replace("_", " ") for name in undetermined)
            clauses.append(f"{listed} of {printable(robot)}")
    if not clauses:
        return ""
    return (
        f"the data do not determine {'; '.join(clauses)}. Record again: change speed and turning "
        "rate often, and turn to both sides"
    )

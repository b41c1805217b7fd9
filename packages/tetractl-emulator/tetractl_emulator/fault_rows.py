"""Variants of faults in randomised test runs: their strength, and the abort reasons that name them.

A randomised test run (a *day* of `tetractl lab rehearse`) samples faults. Each emulated device
lists the kinds of faults that it can have. The variants of a kind are its `rows`. A `FaultRow`
contains a weight, a sampling function for each field of the fault, and a pattern. If the guard ends
a run with a reason that matches the pattern, the guard has named the fault correctly. A device of
another package takes part in these runs with its own kinds.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from random import Random
from typing import Any

from tetractl.core.setup import Setup
from tetractl.spec.lab_section import LabSection

# regular expressions for the reasons with which the guard stops a run, by what has failed
CAMERA_REASONS = (
    r"no new camera frame|no new frames|no frames|outdated|not tracked|too rarely|old on arrival"
    r"|watched long enough|before reception|no camera frame|cannot be found: the camera|frames came"
    r"|no message came|no camera server answers"
)
MOTION_REASONS = (
    r"moves? |turns? |does not move|drift together|off its commanded speed|radio slow"
    r"|camera or its origin|swapped|pose jumped|pose repeats|still moves?|from its start|turned by"
)
PLACE_REASONS = r"about to leave|about to enter|too close"
CELL_REASONS = r"respond to the field|divided, or has parted|been uncertain which cell|are needed"
CLOCK_REASONS = r"server's clock|after reception|before reception"
RADIO_REASONS = r"radio|\bport\b|does not answer|no XBee module answers|battery"
DRIVER_REASONS = r"current driver|\bport\b"
NO_REASON = r"$."  # matches nothing
# reasons by the kind of fault, each of which the guard may notice in several ways
MOVED_REASONS = f"{MOTION_REASONS}|{PLACE_REASONS}|{CAMERA_REASONS}"
LATE_REASONS = f"{CAMERA_REASONS}|{PLACE_REASONS}|{CLOCK_REASONS}|{MOTION_REASONS}"
LINK_REASONS = f"{RADIO_REASONS}|{MOVED_REASONS}"
SEEN_REASONS = f"{MOVED_REASONS}|{CELL_REASONS}|no image|damaged|image is|in view|was the stage"

FRAME_S = 1 / 120
"""Time between two exposures of the emulated camera [s]."""
ENDLESS_STRENGTH = 0.9
"""Minimum strength of a fault that lasts until the test run ends."""
DEFAULT_COMMAND_HZ = 40.0
"""Rate of commands to m3pi robots if the spec states no rate [Hz]."""


@dataclass(frozen=True, slots=True)
class RandomChoices:
    """The random choices for one fault, from which its fields are sampled.

    Attributes:
        random: The random generator.
        names: The robots, in random order.
        strength: Strength of the fault, uniform in [0, 1).
        scale: Factor for lengths that are given for a robot with 200 mm/s.
    """

    random: Random
    names: Sequence[str]
    strength: float
    scale: float = 1.0


FieldSampler = Callable[[RandomChoices], Any]
"""Function that samples the value of one field of a fault."""


def value_between(low: float, high: float) -> FieldSampler:
    """Create a function that samples a value from `low` to `high`, to four significant digits.

    The value changes exponentially with the fault's strength, from `low` at 0 to `high` at 1.
    `low` can be the larger one.
    """
    return lambda choices: float(f"{low * (high / low) ** choices.strength:.4g}")


def whole_number(low: float, high: float) -> FieldSampler:
    """Create a function that samples like `value_between`, rounded to the nearest whole number."""
    sample_value = value_between(low, high)
    return lambda choices: round(sample_value(choices))


def fraction_between(low: float, high: float) -> FieldSampler:
    """Create a function that samples a fraction like `value_between`, but at most 1."""
    sample_value = value_between(low, high)
    return lambda choices: min(1.0, sample_value(choices))


def one_minus(low: float, high: float, remaining_min: float = 0.0) -> FieldSampler:
    """Create a function that samples 1 minus a random loss.

    Args:
        low: Minimum loss.
        high: Maximum loss.
        remaining_min: Minimum of the result.
    """
    sample_loss = value_between(low, high)
    return lambda choices: max(remaining_min, round(1 - sample_loss(choices), 4))


def signed_value(low: float, high: float, per_frame: float = 1.0) -> FieldSampler:
    """Create a function that samples like `value_between`, with a random sign.

    Args:
        low: Minimum absolute value.
        high: Maximum absolute value.
        per_frame: Factor for the result, for example to convert a speed to a change per frame.
    """
    sample_size = value_between(low, high)
    return lambda choices: round(
        choices.random.choice((-1, 1)) * sample_size(choices) * per_frame, 7
    )


def factor_near_one(low: float, high: float, per_frame: float = 1.0) -> FieldSampler:
    """Create a function that samples a factor near 1.

    Args:
        low: Minimum difference from 1.
        high: Maximum difference from 1.
        per_frame: Factor for the difference, for example to convert it to a change per frame.
    """
    sample_change = signed_value(low, high, per_frame)
    return lambda choices: 1 + sample_change(choices)


def random_vector(low: float, high: float) -> FieldSampler:
    """Create a function that samples a vector [x, y] in a random direction.

    Its length is sampled like `value_between`.
    """
    sample_length = value_between(low, high)
    return lambda choices: _to_vector(
        sample_length(choices), choices.random.uniform(-math.pi, math.pi)
    )


def scaled_vector(low: float, high: float, per_frame: float = 1.0) -> FieldSampler:
    """Create a function that samples a vector in a random direction, scaled to the robots' speed.

    Args:
        low: Minimum length, for a robot with 200 mm/s.
        high: Maximum length, for a robot with 200 mm/s.
        per_frame: Factor for the result, for example to convert a speed to a change per frame.
    """
    sample_vector = random_vector(low, high)
    return lambda choices: [
        round(value * choices.scale * per_frame, 6) for value in sample_vector(choices)
    ]


def along_line(low: float, high: float, angle: float) -> FieldSampler:
    """Create a function that samples a displacement per frame, forwards or backwards along a line.

    Args:
        low: Minimum speed, for a robot with 200 mm/s.
        high: Maximum speed, for a robot with 200 mm/s.
        angle: Direction of the line [rad].
    """
    sample_speed = signed_value(low, high)
    return lambda choices: _to_vector(sample_speed(choices) * choices.scale * FRAME_S, angle)


def one_of(*values: Any) -> FieldSampler:
    """Create a function that samples one of the values with equal probability."""
    return lambda choices: choices.random.choice(values)


def two_whole_numbers(sample_value: FieldSampler) -> FieldSampler:
    """Create a function that samples two whole numbers, and returns them as a list.

    Args:
        sample_value: Samples each of the numbers, which are then rounded.
    """
    return lambda choices: [round(sample_value(choices)), round(sample_value(choices))]


def lost_fraction(choices: RandomChoices) -> float:
    """Sample a fraction of lost messages, from 5 to 98 %, or 1 for a strong fault.

    Fractions near 98 % are as frequent as fractions near 5 %.
    """
    fraction = 1.0 / (1.0 + math.exp(3.0 - 7.0 * choices.strength / ENDLESS_STRENGTH))
    return round(fraction, 4) if choices.strength < ENDLESS_STRENGTH else 1.0


def first_robot(choices: RandomChoices) -> str:
    """Return the name of the robot that has the fault: the first of the names in random order."""
    return choices.names[0]


NAME_FUNCTIONS = {"robot": first_robot, "cell": first_robot, "other": lambda d: d.names[1]}
"""Functions that sample the fields that name robots.

A kind whose field of this name is required gets the function in each of its variants.
"""
WHEEL_SIDES = one_of("left", "right", "both")
"""Samples the field `wheel` of a fault."""


def _to_vector(length: float, angle: float) -> list[float]:
    """Return [x, y] of a vector with a length and an angle [rad], rounded to 6 decimals."""
    x = length * math.cos(angle)
    y = length * math.sin(angle)
    return [round(x, 6), round(y, 6)]


@dataclass(frozen=True, slots=True)
class FaultRow:
    """A variant of a fault in randomised test runs.

    Attributes:
        name: Name of the variant.
        reason_pattern: Regular expression that matches the guard's reasons which name the fault
            correctly.
        fields: Fields of the fault in a script: values, or functions that sample them.
        at_once: Whether the fault has no duration.
        weight: Relative frequency of the variant.
        start_fraction: Fraction of the runs in which the fault begins with the emulation.
        stop_fraction: Fraction of the runs in which the fault begins when the robots stop.
        fault: Name of the kind of fault. `fault_kind` sets it.
    """

    name: str
    reason_pattern: str
    fields: Mapping[str, Any] = field(default_factory=dict)
    at_once: bool = False
    weight: float = 1.0
    start_fraction: float = 0.1
    stop_fraction: float = 0.2
    fault: str = ""


def length_scale(lab: LabSection, setup: Setup) -> float:
    """Compute the factor by which to scale lengths that are given for robots with 200 mm/s.

    For cells, it is the maximum speed divided by 200 mm/s. For robots on wheels, it is 1.
    """
    fastest_mm_s = float(setup.speed.max()) * setup.metres * 1000
    return fastest_mm_s / 200 if lab.actuator.type == "field" else 1.0

"""What a fault is on a rehearsed day: how its strength is drawn, and which words name it rightly.

Each emulated device lists the kinds of faults that it can have. A kind has `rows`, its variants on
a day: a `FaultRow` has a weight, a draw for each field of the fault, and a pattern; a guard that
ends a run with a reason which matches it has named the fault. So a device of another package takes
part in rehearsals by its own kinds.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from random import Random
from typing import Any

from tetractl.core.setup import Setup
from tetractl.spec.lab_section import LabSection

# regular expressions of reasons
SIGHT = (
    r"no new camera frame|no new frames|no frames|outdated|not tracked|too rarely|old on arrival"
    r"|watched long enough|before reception|no camera frame|not known: the camera|frames came"
    r"|no message came|no camera server answers"
)
MOTION = (
    r"moves? |turns? |does not move|drift together|off its commanded speed|radio slow"
    r"|camera or its origin|swapped|pose jumped|pose repeats|still moves|from its start|turned by"
)
PLACE = r"about to leave|about to enter|too close"
CELLS = r"respond to the field|divided, or has parted|not been known which cell|are needed"
CLOCK = r"server's clock|after reception|before reception"
RADIO = r"radio|\bport\b|does not answer|no XBee module answers|battery"
DRIVER = r"current driver|\bport\b"
NOTHING = r"$."
MOVED = f"{MOTION}|{PLACE}|{SIGHT}"
LATE = f"{SIGHT}|{PLACE}|{CLOCK}|{MOTION}"
LINK = f"{RADIO}|{MOVED}"
SEEN = f"{MOVED}|{CELLS}|no picture|damaged|picture is|in view|was the stage"

FRAME_S = 1 / 120
"""Time between two exposures of the emulated camera [s]."""
STRONG = 0.9
"""Strength from which on a fault lasts to the end."""
OUR_HZ = 40.0
"""Rate at which m3pi robots are sent commands by a spec that names none."""


@dataclass(frozen=True, slots=True)
class Draw:
    """The random choices for one fault.

    Attributes:
        random: The random generator.
        names: The robots, in a random order.
        strength: How strong the fault is, uniform in [0, 1).
        scale: Factor for lengths that are given for a robot with 200 mm/s.
    """

    random: Random
    names: Sequence[str]
    strength: float
    scale: float = 1.0


DrawValue = Callable[[Draw], Any]


def between(low: float, high: float) -> DrawValue:
    """Create a function that samples a value between two bounds.

    The strength of the fault chooses the value: equal steps of the strength are equal ratios.
    """
    return lambda d: float(f"{low * (high / low) ** d.strength:.4g}")


def whole_number(low: float, high: float) -> DrawValue:
    """Return the draw of a whole number as `between`."""
    value = between(low, high)
    return lambda d: round(value(d))


def part(low: float, high: float) -> DrawValue:
    """Return the draw of a share as `between`, 1 at most."""
    value = between(low, high)
    return lambda d: min(1.0, value(d))


def less(low: float, high: float, remaining_min: float = 0.0) -> DrawValue:
    """Sample what remains of 1 after a random loss.

    Args:
        low: Minimum loss.
        high: Maximum loss.
        remaining_min: Minimum of the result.
    """
    lacking = between(low, high)
    return lambda d: max(remaining_min, round(1 - lacking(d), 4))


def signed(low: float, high: float, a_frame: float = 1.0) -> DrawValue:
    """Sample a value like `between`, with a random sign.

    Args:
        low: Minimum size.
        high: Maximum size.
        a_frame: Factor for the result.
    """
    size = between(low, high)
    return lambda d: round(d.random.choice((-1, 1)) * size(d) * a_frame, 7)


def factor(low: float, high: float, a_frame: float = 1.0) -> DrawValue:
    """Sample a factor that differs from 1 by a value like `signed`.

    Args:
        low: Minimum size of the difference.
        high: Maximum size of the difference.
        a_frame: Factor for the difference.
    """
    change = signed(low, high, a_frame)
    return lambda d: 1 + change(d)


def vector(low: float, high: float) -> DrawValue:
    """Return the draw of a vector of a length between two, in any direction."""
    length = between(low, high)
    return lambda d: _vector(length(d), d.random.uniform(-math.pi, math.pi))


def off(low: float, high: float, a_frame: float = 1.0) -> DrawValue:
    """Sample a vector like `vector`, in the robots' scale.

    Args:
        low: Minimum length.
        high: Maximum length.
        a_frame: Factor for the result.
    """
    draw = vector(low, high)
    return lambda d: [round(value * d.scale * a_frame, 6) for value in draw(d)]


def along(low: float, high: float, angle: float) -> DrawValue:
    """Sample the displacement in a frame at a random speed along a direction, in either sense.

    Args:
        low: Minimum speed.
        high: Maximum speed.
        angle: The direction [rad].
    """
    speed = signed(low, high)
    return lambda d: _vector(speed(d) * d.scale * FRAME_S, angle)


def one_of(*values: Any) -> DrawValue:
    """Return the draw of one of some values."""
    return lambda d: d.random.choice(values)


def pair(draw: DrawValue) -> DrawValue:
    """Return the draw of two whole numbers."""
    return lambda d: [round(draw(d)), round(draw(d))]


def lost(d: Draw) -> float:
    """Return a share from 5 to 98 %, near 98 % as often as near 5 %; a strong one is 1."""
    share = 1.0 / (1.0 + math.exp(3.0 - 7.0 * d.strength / STRONG))
    return round(share, 4) if d.strength < STRONG else 1.0


def first_robot(d: Draw) -> str:
    """Return the robot that has the fault."""
    return d.names[0]


NAMES = {"robot": first_robot, "cell": first_robot, "other": lambda d: d.names[1]}
"""The draws of fields that name robots; each row has those that its kind cannot do without."""
WHEEL = one_of("left", "right", "both")


def _vector(length: float, angle: float) -> list[float]:
    x = length * math.cos(angle)
    y = length * math.sin(angle)
    return [round(x, 6), round(y, 6)]


@dataclass(frozen=True, slots=True)
class FaultRow:
    """A variant of a fault in randomised test runs.

    Attributes:
        name: Its name.
        right: Pattern of the reasons that name the fault correctly.
        fields: Fields of the script: values, or functions that sample them.
        at_once: Whether the fault has no duration.
        weight: Relative frequency.
        start: Fraction of the runs in which it begins together with the emulation.
        stop: Fraction of the runs in which it begins when the robots stop.
        fault: Name of the kind of fault.
    """

    name: str
    right: str
    fields: Mapping[str, Any] = field(default_factory=dict)
    at_once: bool = False
    weight: float = 1.0
    start: float = 0.1
    stop: float = 0.2
    fault: str = ""


def scale_of(lab: LabSection, setup: Setup) -> float:
    """Return the factor for lengths that are given for robots with 200 mm/s.

    For cells, it follows from their speeds. For all robots on wheels, it is 1.
    """
    fastest_mm_s = float(setup.speed.max()) * setup.metres * 1000
    return fastest_mm_s / 200 if lab.actuator.type == "field" else 1.0

"""Two-wheeled robots that move like cells by the paper's equations (21)-(25); their wheel counts.

A wheel runs at gain * (|count| - dead zone) mm/s, and stands within the dead zone. One count turns
an m3pi at about 0.19 rad/s, too much to neglect: the rounding error is carried to the next command
(error diffusion), so that the mean of the speeds sent is the requested speed.
"""

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats

COUNT_MAX = 127
Counts = tuple[int, int]
"""Counts of the left and the right wheel, each in -COUNT_MAX..COUNT_MAX."""
STOP: Counts = (0, 0)


def wheel_speeds(
    heading: Floats, u: Floats | float, a: Floats, v: Floats, r: Floats | float
) -> tuple[Floats, Floats]:
    """Return left and right wheel speeds [length unit/s] by the paper's equations (24)-(25).

    heading, a [rad/s] and v [length unit/s] have shape (N,); r is the distance from a wheel to the
    centre [length unit].
    """
    difference = a * r * np.sin(u - heading)
    return v - difference, v + difference


def body_velocity(left: Floats, right: Floats, r: Floats | float) -> tuple[Floats, Floats]:
    """Return (speed v [length unit/s], turning rate [rad/s]) of given wheel speeds.

    dx/dt = (right + left) cos(heading) / 2                                             (21)
    dy/dt = (right + left) sin(heading) / 2                                             (22)
    dheading/dt = (right - left) / (2 r)                                                (23)
    """
    return (right + left) / 2, (right - left) / (2 * r)


@dataclass(frozen=True, slots=True)
class Wheel:
    """One wheel: `gain` [mm/s per count], and `dead_zone`, the largest count without motion.

    With `invert`, positive counts drive the wheel backwards.
    """

    gain: float = 1000.0 / COUNT_MAX
    dead_zone: int = 0
    invert: bool = False

    def __post_init__(self) -> None:
        if not (math.isfinite(self.gain) and self.gain > 0):
            raise ValueError(f"a wheel's gain must be positive, not {self.gain}")
        if not 0 <= self.dead_zone < COUNT_MAX:
            raise ValueError(f"a dead zone of {self.dead_zone} counts is out of range")

    def speed(self, count: int) -> float:
        """Return the speed [mm/s] at a count."""
        steps = max(0, abs(count) - self.dead_zone)
        return self.gain * (steps if (count > 0) != self.invert else -steps)

    def _count(self, steps: int) -> int:
        """Return the count for a speed of `steps` times the gain."""
        if steps == 0:
            return 0
        count = abs(steps) + self.dead_zone
        return count if (steps > 0) != self.invert else -count


@dataclass(frozen=True, slots=True)
class Drivetrain:
    """One robot's calibrated wheels.

    `swap`: the left wheel is connected to the second motor channel. `limit`: the largest count that
    is sent.
    """

    left: Wheel = field(default_factory=Wheel)
    right: Wheel = field(default_factory=Wheel)
    swap: bool = False
    limit: int = COUNT_MAX

    def __post_init__(self) -> None:
        if not max(self.left.dead_zone, self.right.dead_zone) < self.limit <= COUNT_MAX:
            raise ValueError(
                f"the limit must be above the dead zones and at most {COUNT_MAX}, not {self.limit}"
            )


@dataclass(frozen=True, slots=True)
class Residue:
    """Each wheel's rounding error, carried to the next command: -0.5 to 0.5 times the gain."""

    left: float = 0.0
    right: float = 0.0


def wheel_counts(
    left: float, right: float, drivetrain: Drivetrain, residue: Residue
) -> tuple[Counts, Residue]:
    """Return the counts to send for speeds [mm/s], and the residue for the next call.

    If a wheel would exceed the limit, both speeds are scaled equally, which keeps the path's
    curvature. A wheel of speed 0 gets the count 0; if both stand, the residue is cleared.
    ValueError for speeds that are not finite.
    """
    if not (math.isfinite(left) and math.isfinite(right)):
        raise ValueError(f"wheel speeds must be finite, not {left} and {right}")
    if left == 0 and right == 0:
        return STOP, Residue()
    wheels = drivetrain.left, drivetrain.right
    spans = [drivetrain.limit - wheel.dead_zone for wheel in wheels]
    ratios = [
        abs(speed) / wheel.gain / span
        for speed, wheel, span in zip((left, right), wheels, spans, strict=True)
    ]
    scale = 1.0 / max(1.0, *ratios)
    left_steps, left_owed = _diffuse(left * scale / wheels[0].gain, residue.left, spans[0])
    right_steps, right_owed = _diffuse(right * scale / wheels[1].gain, residue.right, spans[1])
    first, second = wheels[0]._count(left_steps), wheels[1]._count(right_steps)
    counts = (second, first) if drivetrain.swap else (first, second)
    return counts, Residue(left_owed, right_owed)


def speeds_of_counts(counts: Counts, drivetrain: Drivetrain) -> tuple[float, float]:
    """Return the left and right wheel speeds [mm/s] for counts."""
    left, right = counts[::-1] if drivetrain.swap else counts
    return drivetrain.left.speed(left), drivetrain.right.speed(right)


class LaggingTurns:
    """Predicts the headings of N robots whose wheels follow commands with a first-order lag T.

    A robot has heading theta and turning rate w at time s. If the turning rates c sent to it act
    until time t, and the rate 0 after t, the robot comes to rest at the heading

        theta + T w(s) + integral of c from s to t.

    If equations (24)-(25) are computed at this heading, robots turn by (3), as without lag.
    """

    def __init__(self, lag_s: float, count: int) -> None:
        self._lag_s = lag_s
        # times from which turning rates act [ns], and the rates (N,) [rad/s], oldest first
        self._sent: deque[tuple[int, Floats]] = deque([(0, np.zeros(count))])
        self._turning = np.zeros(count)  # true rates when the oldest command begins to act

    def sent(self, acts_ns: int, turning: Floats) -> None:
        """Add turning rates (N,) [rad/s], which act from `acts_ns` [ns] on."""
        self._sent.append((acts_ns, turning))

    def ahead(self, heading: Floats, since: int, until: int) -> Floats:
        """Return the headings (N,) [rad] in which robots come to rest if they stop at `until` [ns].

        `heading` (N,) are their headings at `since` [ns]; `since` must not decrease between calls.
        """
        while len(self._sent) > 1 and self._sent[1][0] <= since:
            self._turning = self._turning_at(self._sent[1][0])
            self._sent.popleft()
        found = heading + self._lag_s * self._turning_at(since)
        ends = [begin for begin, _ in self._sent][1:]
        for (begin, turning), end in zip(self._sent, [*ends, until], strict=True):
            found = found + turning * (max(end - max(begin, since), 0) / SECOND)
        return found

    def _turning_at(self, when: int) -> Floats:
        """Return the true turning rates at a time [ns] at which the oldest command acts."""
        begin, wanted = self._sent[0]
        return wanted + (self._turning - wanted) * math.exp(
            min(begin - when, 0) / SECOND / self._lag_s
        )


def _diffuse(wish: float, owed: float, span: int) -> tuple[int, float]:
    """Round `wish` + `owed` to a whole number in -span..span; return it and the rounding error."""
    if wish == 0:
        return 0, owed
    total = wish + owed
    steps = max(-span, min(span, round(total)))
    return steps, max(-0.5, min(0.5, total - steps))

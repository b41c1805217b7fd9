"""Two-wheeled robots that move like cells by the paper's equations (21)-(25).

`Drivetrains` are wheels and their counts, `WheelHost` computes what a host sends, `WheeledRobots`
are the robots' true motion; the simulation, the emulated robots and the lab's actuator use them.

A wheel runs at gain * (|count| - dead zone), and stands within the dead zone. One count turns
an m3pi at about 0.19 rad/s, too much to neglect: the rounding error is carried to the next command
(error diffusion), so that the mean of the speeds sent is the requested speed.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tetractl.core.clock import SECOND
from tetractl.core.poses import Bools, Floats, Poses
from tetractl.model.motion.arc import chain
from tetractl.model.motion.exact import step as exact

COUNT_MAX = 127
Counts = tuple[int, int]
"""Counts of one robot's two wheels, each in -COUNT_MAX..COUNT_MAX."""
STOP: Counts = (0, 0)
CountArray = NDArray[np.int64]


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
class Drivetrains:
    """The wheels of N robots, as calibrated or as they truly are.

    `gain` (2, N) [length unit/s per count] of left and right wheels is negative for a wheel that
    positive counts drive backwards; `dead_zone` (2, N) is the largest count without motion. `limit`
    (N,) is the largest count that is sent. `swap` (N,): the left wheel is connected to the second
    motor channel. Counts (2, N) are in the order of the channels, speeds (2, N) left and right.
    """

    gain: Floats
    dead_zone: CountArray
    limit: CountArray
    swap: Bools

    def speeds(self, counts: CountArray) -> Floats:
        """Return the wheel speeds [length unit/s] for counts."""
        own = self._swapped(counts)
        return self.gain * (np.sign(own) * np.maximum(np.abs(own) - self.dead_zone, 0))

    def counts(self, speeds: Floats, owed: Floats) -> tuple[CountArray, Floats]:
        """Return the counts to send for speeds, and the rounding errors `owed` [counts] (2, N) to
        carry to the next call, each within 0.5.

        If a wheel would exceed the limit, both speeds are scaled equally, which keeps the path's
        curvature. A wheel of speed 0 gets the count 0; if both stand, nothing is owed. ValueError
        for speeds that are not finite.
        """
        if not np.isfinite(speeds).all():
            raise ValueError(f"wheel speeds must be finite, not {speeds.tolist()}")
        span = self.limit - self.dead_zone
        scale = 1.0 / np.maximum(1.0, (np.abs(speeds / self.gain) / span).max(axis=0))
        total = speeds * scale / self.gain + owed  # of a wheel of speed 0: rounds to 0
        steps = np.rint(np.maximum(np.minimum(total, span), -span))
        owed = np.maximum(np.minimum(total - steps, 0.5), -0.5) * speeds.any(axis=0)
        own = (steps + np.sign(steps) * self.dead_zone).astype(np.int64)
        return self._swapped(own), owed

    def _swapped(self, pairs: CountArray) -> CountArray:
        return np.where(self.swap, pairs[::-1], pairs) if self.swap.any() else pairs


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


class WheelHost:
    """Computes the wheel speeds of N robots that all get the same direction.

    `a` [rad/s], `speed` [length unit/s] and `radius` [length unit], the distance from a wheel to
    the centre, are (N,). The wheels are known to follow commands with the time constant `lag_s`
    [s], 0 to neglect it. `drivetrains` are the wheels as calibrated, None if speeds themselves are
    sent.
    """

    def __init__(
        self,
        a: Floats,
        speed: Floats,
        radius: Floats,
        lag_s: float,
        drivetrains: Drivetrains | None = None,
    ) -> None:
        self.drivetrains, self._radius = drivetrains, radius
        self._a, self._speed = a, speed
        self._turns = LaggingTurns(lag_s, a.size) if lag_s > 0 else None
        self._owed = np.zeros((2, a.size))

    def wished(
        self, heading: Floats, u: Floats, since_ns: int, acts_ns: int, ahead: bool = True
    ) -> Floats:
        """Return the wheel speeds (2, N) by equations (24)-(25) for the direction `u` [rad], and
        for the headings predicted from the measured ones (N,), exposed at `since_ns`, to `acts_ns`,
        when the command acts [ns]. If not `ahead`, the speeds turn the robots on the spot.

        Headings are predicted by equation (3) or, if the wheels lag, as the headings in which the
        robots would come to rest after the commands already sent.
        """
        if self._turns is not None:
            heading = self._turns.ahead(heading, since_ns, acts_ns)
        elif acts_ns > since_ns:
            nowhere, ahead_s = np.zeros_like(heading), (acts_ns - since_ns) / SECOND
            _, _, heading = exact(nowhere, nowhere, heading, u, self._a, self._speed, ahead_s)
        return np.array(wheel_speeds(heading, u, self._a, self._speed * ahead, self._radius))

    def counts(self, wished: Floats) -> CountArray:
        """Return the counts (2, N) to send for wheel speeds (2, N)."""
        assert self.drivetrains is not None, "counts need calibrated wheels"
        counts, self._owed = self.drivetrains.counts(wished, self._owed)
        return counts

    def sent(self, acts_ns: int, speeds: Floats) -> tuple[Floats, Floats]:
        """Take wheel speeds (2, N) that were sent and act from `acts_ns` [ns] on; return the
        speeds and the turning rates [rad/s] of the robots, (N,) each."""
        speed, turning = body_velocity(speeds[0], speeds[1], self._radius)
        if self._turns is not None:
            self._turns.sent(acts_ns, turning)
        return speed, turning


class WheeledRobots:
    """The true motion of N robots, whose wheels follow the speeds `targets` (2, N) with a
    first-order lag.

    `radius` [length unit] is the true distance from a wheel to the centre, and `lag_s` [s] the
    wheels' time constant, for all robots or for each (N,), 0 for none. Stopped robots stand once
    all wheels are slower than `still` [length unit/s]. `wheels` (2, N) are the present speeds.
    """

    chain = staticmethod(chain)

    def __init__(self, poses: Poses, radius: Floats, lag_s: float | Floats, still: float) -> None:
        self.poses = poses
        self.targets = np.zeros((2, radius.size))
        self.wheels = np.zeros((2, radius.size))
        self._radius, self._lag, self._still = radius, lag_s + 0 * radius, still
        self._lags = bool(np.any(lag_s))
        self.scale(np.ones(radius.size), np.ones(radius.size))

    def scale(self, turning: Floats, speed: Floats) -> None:
        """From now on, multiply turning rates and speeds by factors (N,), as by slip."""
        self._rates = np.array([turning / (2 * self._radius), speed / 2])

    def wheels_in(self, seconds: float) -> Floats:
        """Return the wheel speeds (2, N) after a time [s] from now."""
        behind = self.wheels - self.targets
        return self.targets + (behind * np.exp(-seconds / self._lag) if self._lags else 0.0)

    def drive(
        self, seconds: Floats, swerves: Floats | None = None
    ) -> tuple[Floats, Floats, Floats]:
        """Advance the robots; return x, y, heading (M, N) at the times `seconds` (M,) from now.

        The headings turn by `swerves` (M, N) [rad] in addition, each at its time. Wheel speeds,
        distances and headings are exact. A position is the sum of the chords between the times,
        each that of an arc: exact for settled wheels, otherwise the error falls with the square of
        the time between two.
        """
        p, target, share = self.poses, self.targets, np.ones((seconds.size, self._radius.size))
        if self._lags:  # completed fraction of the change
            share = -np.expm1(seconds[:, None] / -self._lag)
        behind = self.wheels - target
        self.wheels = target + behind * (1 - share[-1])
        if not target.any() and np.abs(self.wheels).max() < self._still:
            self.wheels = target
        wheels = np.concatenate([target, self._lag * behind])
        swerves = np.zeros_like(share) if swerves is None else swerves
        x, y, heading = self.chain(
            np.array([p.x, p.y, p.heading]), wheels, seconds, share, self._rates, swerves
        )
        self.poses = Poses(x[-1], y[-1], heading[-1])
        return x, y, heading

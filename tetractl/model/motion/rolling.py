"""Two-wheeled robots in plain loops: the wheel speeds that a host sends, and the motion.

    host      wish    wheel speeds towards a direction, by the paper's (24)-(25), for the headings
                      that robots will have when the speeds take effect; `note` records what was
                      sent
              count   speeds rounded to whole counts of a motor
    robots    roll    x, y and heading after some time, by (21)-(23)

The emulated robots and the lab's actuator run these loops uncompiled, through the classes of
`model.wheels`. `plant.drive_kernels` compiles them for the simulation, with the same results to the
bit.
"""

from typing import Any, NamedTuple, Self

import numpy as np

from tetractl.core.clock import NEVER_NS, SECOND
from tetractl.core.elementary import exp, expm1, sin
from tetractl.core.poses import Bools, Floats, Times
from tetractl.model.motion.exact import turn
from tetractl.model.motion.wheel_equations import arc_displacement, wheel_speeds


def count(speeds: Floats, owed: Floats, gain: Floats, dead_zone: Any, limit: Any) -> Floats:
    """Convert wheel speeds to counts beyond the dead zones, shape (2, N); see `Drivetrains.counts`.

    Args:
        speeds: Wheel speeds [length unit/s], shape (2, N).
        owed: Rounding errors of earlier calls [counts], shape (2, N), changed in place.
        gain: Speed of a wheel for each count [length unit/s], shape (2, N).
        dead_zone: Counts at which a wheel does not turn yet, shape (2, N).
        limit: Maximum count of each robot, shape (N,).
    """
    steps = np.empty(speeds.shape)
    for i in range(speeds.shape[1]):
        scale = 1.0
        for side in range(2):
            span = limit[i] - dead_zone[side, i]
            scale = max(scale, abs(speeds[side, i] / gain[side, i]) / span)
        drives = speeds[0, i] != 0 or speeds[1, i] != 0
        for side in range(2):
            span = limit[i] - dead_zone[side, i]
            total = speeds[side, i] * (1.0 / scale) / gain[side, i] + owed[side, i]
            steps[side, i] = round(max(min(total, span), -span))
            owed[side, i] = max(min(total - steps[side, i], 0.5), -0.5) if drives else 0.0
    return steps


class KnownRobots(NamedTuple):
    """The properties of N robots on wheels that their host knows, (N,) each."""

    a: Floats
    """Turning rates of the robots [rad/s], shape (N,)."""
    speed: Floats
    """Speeds of the robots [length unit/s], shape (N,). 0 for robots that turn on the spot."""
    radius: Floats
    """Distance from a wheel to the centre of each robot [length unit], shape (N,)."""
    lag_s: float
    """Time constant T with which all wheels follow commands [s]. 0 to neglect it."""

    def turning(self) -> Self:
        """Return the same robots with speed 0, so that they turn on the spot."""
        return self._replace(speed=np.zeros_like(self.speed))


ENTRIES_AT_FIRST = 8
"""Initial number of entries of `SentRates`. It doubles when all are in use."""


class SentRates(NamedTuple):
    """The turning rates sent to N robots that still matter. `wish` drops older ones."""

    times_ns: Times
    """Times at which the rates take effect [ns], oldest first, shape (Q,).

    NEVER marks unused entries. The last entry is always unused.
    """
    rates: Floats
    """Turning rates that the wheels follow from each of these times on [rad/s], shape (Q, N)."""
    true_at_first: Floats
    """True turning rates of the lagging wheels at the first of the times [rad/s], shape (N,)."""

    @classmethod
    def none(cls, robots: int) -> Self:
        """Create rates of 0 for robots that stand still, with space for later rates."""
        times_ns = np.full(ENTRIES_AT_FIRST, NEVER_NS)
        times_ns[0] = 0
        return cls(times_ns, np.zeros((ENTRIES_AT_FIRST, robots)), np.zeros(robots))

    def with_room(self) -> "SentRates":
        """Return the same rates in arrays with space for one more entry.

        These are the same arrays if they have space already.
        """
        if self.times_ns[-2] == NEVER_NS:
            return self
        return SentRates(
            times_ns=np.concatenate([self.times_ns, np.full_like(self.times_ns, NEVER_NS)]),
            rates=np.concatenate([self.rates, np.zeros_like(self.rates)]),
            true_at_first=self.true_at_first,
        )


def wish(
    heading: Floats, u: Floats, since_ns: int, acts_ns: int, robots: KnownRobots, sent: SentRates
) -> Floats:
    """Compute the wheel speeds (2, N) that turn robots towards directions, equations (24)-(25).

    The speeds, left and right, are computed for the headings at `acts_ns`, when the command takes
    effect. These are predicted from the measured headings. Wheels without a lag have turned by (3)
    until then. For wheels with a lag, the heading in which the robot would come to a standstill is
    used: from there, robots turn by (3), as without a lag.

    Args:
        heading: Measured headings [rad], shape (N,).
        u: Directions [rad], shape (N,).
        since_ns: Time of the measurement. It must not decrease between calls, because `sent`
            forgets older rates.
        acts_ns: When the command takes effect.
        robots: What the host knows of the robots.
        sent: The rates sent so far.
    """
    if robots.lag_s > 0:
        forget(sent, since_ns, robots.lag_s)
        predicted = headings_at_rest(heading, since_ns, acts_ns, robots.lag_s, sent)
    else:
        predicted = headings_turned(heading, u, since_ns, acts_ns, robots.a)
    wished = np.empty((2, len(heading)))
    for i in range(len(heading)):
        sin_phi = sin(u[i] - predicted[i])
        wished[0, i], wished[1, i] = wheel_speeds(
            sin_phi, robots.a[i], robots.speed[i], robots.radius[i]
        )
    return wished


def headings_turned(heading: Floats, u: Floats, since_ns: int, acts_ns: int, a: Floats) -> Floats:
    """Predict the headings after robots have turned towards directions by (3), shape (N,).

    Args:
        heading: Headings at `since_ns` [rad], shape (N,).
        u: Directions [rad], shape (N,).
        since_ns: When robots start to turn.
        acts_ns: When the headings are wanted.
        a: Turning rates [rad/s], shape (N,).
    """
    seconds = (acts_ns - since_ns) / SECOND
    turned = heading.copy()
    if seconds > 0:
        for i in range(len(heading)):
            turned[i] = heading[i] + turn(u[i] - heading[i], a[i], seconds)
    return turned


def headings_at_rest(
    heading: Floats, since_ns: int, acts_ns: int, lag_s: float, sent: SentRates
) -> Floats:
    """Predict the headings (N,) in which robots come to a standstill if they stop at `acts_ns`.

    A robot has the heading theta and the true turning rate w at `since_ns`. Its wheels follow the
    rates c that were sent with the time constant T, until `acts_ns`, and then 0. It comes to a
    standstill at

        theta + T w + integral of c from `since_ns` to `acts_ns`.

    Args:
        heading: Headings at `since_ns` [rad], shape (N,).
        since_ns: Time of the measurement.
        acts_ns: When the robots stop.
        lag_s: The time constant T [s].
        sent: The rates sent so far.
    """
    times_ns = sent.times_ns
    # fraction of the first difference of rates that the lag has left at `since_ns`
    remaining = exp(min(times_ns[0] - since_ns, 0) / SECOND / lag_s)
    at_rest = np.empty(len(heading))
    for i in range(len(heading)):
        rate = sent.rates[0, i] + (sent.true_at_first[i] - sent.rates[0, i]) * remaining
        theta = heading[i] + lag_s * rate
        k = 0
        while times_ns[k] < acts_ns:
            begin_ns = max(times_ns[k], since_ns)
            end_ns = min(times_ns[k + 1], acts_ns)
            theta += sent.rates[k, i] * (max(end_ns - begin_ns, 0) / SECOND)
            k += 1
        at_rest[i] = theta
    return at_rest


def forget(sent: SentRates, now_ns: int, lag_s: float) -> None:
    """Drop the rates that were replaced by others before `now_ns`.

    Args:
        sent: The rates sent so far.
        now_ns: The time.
        lag_s: Time constant of the wheels [s].
    """
    times_ns = sent.times_ns
    rates = sent.rates
    true_rates = sent.true_at_first
    while times_ns[1] <= now_ns:
        remaining = exp((times_ns[0] - times_ns[1]) / SECOND / lag_s)
        for i in range(len(true_rates)):
            true_rates[i] = rates[0, i] + (true_rates[i] - rates[0, i]) * remaining
        for k in range(1, len(times_ns)):
            times_ns[k - 1] = times_ns[k]
            for i in range(len(true_rates)):
                rates[k - 1, i] = rates[k, i]


def note(sent: SentRates, acts_ns: int, speeds: Floats, radius: Floats) -> None:
    """Record wheel speeds that were sent. There must be space for them.

    Args:
        sent: The rates sent so far.
        acts_ns: When the speeds take effect [ns].
        speeds: Wheel speeds [length unit/s], shape (2, N).
        radius: Distance from a wheel to the centre [length unit], shape (N,).
    """
    k = 0
    while sent.times_ns[k] != NEVER_NS:
        k += 1
    sent.times_ns[k] = acts_ns
    for i in range(len(radius)):
        sent.rates[k, i] = (speeds[1, i] - speeds[0, i]) / (2 * radius[i])


# the rows of the array (ROWS, N) of N robots on wheels
X = 0  # [length unit]
Y = 1  # [length unit]
HEADING = 2  # [rad]
LEFT = 3
"""Row of the present speed of the left wheel [length unit/s]."""
RIGHT = 4
"""Row of the present speed of the right wheel [length unit/s]."""
LEFT_TARGET = 5
"""Row of the speed that the left wheel approaches with its lag [length unit/s]."""
RIGHT_TARGET = 6
"""Row of the speed that the right wheel approaches with its lag [length unit/s]."""
TURNS = 7
"""Row of the turn for each unit by which the wheels' paths differ [rad/length unit]."""
MOVES = 8
"""Row of the distance that a robot moves for each unit of the sum of its wheels' paths."""
LAG = 9
"""Row of the wheels' time constant [s]."""
STANDS_BELOW = 10
"""Row of the speed below which the wheels of a stopped robot stand still [length unit/s]."""
MOVING = 11
"""Row of factors of the heading's random walk: 1 for a robot that moves, 0 for the others."""
ROWS = 12  # of the array


def roll(
    body: Floats,
    now_ns: int,
    times: Times,
    ticks: Bools,
    walk: float,
    random_numbers: Floats,
    path: Floats,
) -> None:
    """Advance N robots, and write their poses at given times.

    The path does not depend on how it is divided into calls.

    Args:
        body: State of the robots, shape (ROWS, N), changed in place.
        now_ns: The time of the state.
        times: Times of the poses [ns], shape (M,).
        ticks: Whether the heading swerves at each time after `now_ns`, shape (M,).
        walk: Size of a swerve [rad].
        random_numbers: Standard normal numbers, shape (number of ticks, N). Each swerve is `walk`
            times the next number.
        path: Filled with x, y and heading, shape (M, 3, N).
    """
    since_ns = now_ns
    tick = 0
    for k in range(len(times)):
        _step(body, (times[k] - since_ns) / SECOND)
        since_ns = times[k]
        if walk > 0 and ticks[k] and times[k] > now_ns:
            for i in range(body.shape[1]):
                body[HEADING, i] += walk * random_numbers[tick, i] * body[MOVING, i]
        for row in range(3):
            for i in range(body.shape[1]):
                path[k, row, i] = body[row, i]
        if ticks[k]:
            tick += 1


def _step(body: Floats, seconds: float) -> None:
    """Move robots (ROWS, N) along the chords of their circular arcs, by the paper's (21)-(23).

    Wheel speeds, distances and headings are exact. Chords are exact once the wheels have reached
    their speeds. Before that, their error falls with the square of the time.
    """
    completed = 1.0  # fraction of the change of the wheels' speeds
    for i in range(body.shape[1]):
        lag = body[LAG, i]
        heading = body[HEADING, i]
        left_target = body[LEFT_TARGET, i]
        right_target = body[RIGHT_TARGET, i]
        if i == 0 or lag != body[LAG, i - 1]:
            completed = 1.0 if lag == 0 else -expm1(seconds / -lag)
        # the speeds approach their targets exponentially; these are the differences before the step
        left_missing = body[LEFT, i] - left_target
        right_missing = body[RIGHT, i] - right_target
        body[LEFT, i] = left_target + left_missing * (1 - completed)
        body[RIGHT, i] = right_target + right_missing * (1 - completed)
        fastest = max(abs(body[LEFT, i]), abs(body[RIGHT, i]))
        if left_target == 0 and right_target == 0 and fastest < body[STANDS_BELOW, i]:
            body[LEFT, i] = 0.0
            body[RIGHT, i] = 0.0
        left_distance = left_target * seconds + lag * left_missing * completed
        right_distance = right_target * seconds + lag * right_missing * completed
        angle = body[TURNS, i] * (right_distance - left_distance)  # (23)
        east, north = arc_displacement(
            heading, angle, body[MOVES, i] * (right_distance + left_distance)
        )  # (21), (22)
        body[X, i] += east
        body[Y, i] += north
        body[HEADING, i] = heading + angle

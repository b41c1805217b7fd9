"""Two-wheeled robots, see `model.wheels`: what a host sends them, and where they go.

Plain loops over arrays: `tetractl.plant.wheel_kernel` compiles them for the simulation.
"""

import math
from typing import Any

import numpy as np

from tetractl.core.clock import NEVER, SECOND
from tetractl.core.poses import Bools, Floats, Times
from tetractl.model.motion.exact import turn

SERIES_HALF_TURN_RAD = 0.3
"""Half the angle of an arc [rad] below which sin(h)/h is four terms of its series, to 1e-9."""


def count(speeds: Floats, owed: Floats, gain: Floats, dead_zone: Any, limit: Any) -> Floats:
    """Return the counts beyond the dead zones (2, N) for speeds, see `Drivetrains.counts`."""
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


def wheel_speeds(sine: Any, a: Any, v: Any, radius: Any) -> Any:
    """Return left and right wheel speeds [length unit/s] by the paper's (24)-(25), for the `sine`
    of u - heading, a [rad/s], v [length unit/s], and the distance from a wheel to the centre."""
    difference = a * radius * sine
    return v - difference, v + difference


def rolled(heading: float, angle: float, way: float) -> tuple[float, float]:
    """Return the displacement x, y on an arc by (21)-(23), of a robot that turns by `angle`."""
    half = angle / 2
    if abs(half) <= SERIES_HALF_TURN_RAD:
        square = angle * angle / 4
        sinc = 1 - square / 6 * (1 - square / 20 * (1 - square / 42))
    else:
        sinc = math.sin(half) / half
    chord = way * sinc
    return chord * math.cos(heading + half), chord * math.sin(heading + half)


def wish(
    heading: Floats,
    u: Floats,
    drives: bool,
    since_ns: int,
    acts_ns: int,
    parameters: Floats,
    lag_s: float,
    sent_ns: Times,
    sent: Floats,
) -> Floats:
    """Return the wheel speeds (2, N) by (24)-(25) for the directions `u` (N,) [rad], and for the
    headings predicted from the measured ones (N,), exposed at `since_ns`, to `acts_ns`, when the
    command acts [ns]; `since_ns` must not decrease between calls. If not `drives`, the speeds turn
    the robots on the spot. `parameters` (3, N) are a [rad/s], speed and radius.

    Without a lag, headings are predicted by (3). If the wheels follow commands with a first-order
    lag T = `lag_s` [s], a robot has heading theta and turning rate w at time s. If the turning
    rates c sent to it act until time t, and the rate 0 after t, the robot comes to rest at

        theta + T w(s) + integral of c from s to t.

    If equations (24)-(25) are computed at this heading, robots turn by (3), as without lag.
    From the times `sent_ns` (Q,) [ns] the rates `sent[1:]` (Q, N) [rad/s] act, oldest first, NEVER
    for entries not in use, such as the last; `sent[0]` are the true rates at the first time.
    """
    wished = np.empty((2, len(heading)))
    share = 0.0  # of the difference of true rate and rate sent that is left after a time
    if lag_s > 0:
        while sent_ns[1] <= since_ns:  # forget the oldest
            share = math.exp((sent_ns[0] - sent_ns[1]) / SECOND / lag_s)
            for i in range(len(heading)):
                sent[0, i] = sent[1, i] + (sent[0, i] - sent[1, i]) * share
                for k in range(1, len(sent_ns)):
                    sent[k, i] = sent[k + 1, i]
            for k in range(1, len(sent_ns)):
                sent_ns[k - 1] = sent_ns[k]
        share = math.exp(min(sent_ns[0] - since_ns, 0) / SECOND / lag_s)
    for i in range(len(heading)):
        a = parameters[0, i]
        speed = parameters[1, i] if drives else 0.0
        radius = parameters[2, i]
        theta = heading[i]
        if lag_s > 0:
            theta = theta + lag_s * (sent[1, i] + (sent[0, i] - sent[1, i]) * share)
            k = 0
            while sent_ns[k] < acts_ns:
                begin = max(sent_ns[k], since_ns)
                end = min(sent_ns[k + 1], acts_ns)
                theta += sent[k + 1, i] * (max(end - begin, 0) / SECOND)
                k += 1
        elif acts_ns > since_ns:
            theta += turn(u[i] - theta, a, (acts_ns - since_ns) / SECOND)
        wished[0, i], wished[1, i] = wheel_speeds(math.sin(u[i] - theta), a, speed, radius)
    return wished


def note(acts_ns: int, speeds: Floats, parameters: Floats, sent_ns: Times, sent: Floats) -> None:
    """Add wheel speeds (2, N), which act from `acts_ns` [ns] on, to those sent; see `wish`."""
    k = 0
    while sent_ns[k] != NEVER:
        k += 1
    sent_ns[k] = acts_ns
    for i in range(speeds.shape[1]):
        sent[k + 1, i] = (speeds[1, i] - speeds[0, i]) / (2 * parameters[2, i])


# the rows of the array (ROWS, N) of N robots on wheels
X = 0  # [length unit]
Y = 1  # [length unit]
HEADING = 2  # [rad]
LEFT = 3
"""Present speed of the left wheel [length unit/s]."""
RIGHT = 4
"""Present speed of the right wheel [length unit/s]."""
LEFT_TARGET = 5
"""The speed that the left wheel follows [length unit/s]."""
RIGHT_TARGET = 6
"""The speed that the right wheel follows [length unit/s]."""
TURNS = 7
"""Factor by which the difference of the wheels' ways turns the robot [rad/length unit]."""
MOVES = 8
"""Factor by which the sum of the wheels' ways moves the robot."""
LAG = 9
"""The wheels' time constant [s]."""
STANDS_BELOW = 10
"""Speed below which the wheels of a stopped robot stand [length unit/s]."""
MOVING = 11
"""1 for a robot whose heading swerves, else 0."""
ROWS = 12  # of the array


def roll(
    body: Floats,
    now_ns: int,
    times: Times,
    ticks: Bools,
    walk: float,
    drawn: Floats,
    path: Floats,
) -> None:
    """Advance N robots, `body` (ROWS, N), from `now_ns` to the last of the `times` (M,) [ns]; write
    x, y, heading at these into `path` (M, 3, N).

    At each time after `now_ns` for which `ticks` (M,) is True, a heading swerves by `walk` [rad]
    times its next number in `drawn` (number of ticks, N). A path does not depend on how it is
    divided into calls.
    """
    since = now_ns
    tick = 0
    for k in range(len(times)):
        _step(body, (times[k] - since) / SECOND)
        since = times[k]
        if walk > 0 and ticks[k] and times[k] > now_ns:
            for i in range(body.shape[1]):
                body[HEADING, i] += walk * drawn[tick, i] * body[MOVING, i]
        for row in range(3):
            for i in range(body.shape[1]):
                path[k, row, i] = body[row, i]
        if ticks[k]:
            tick += 1


def _step(body: Floats, seconds: float) -> None:
    """Advance robots (ROWS, N) along the chords of arcs, by (21)-(23). Wheel speeds, distances and
    headings are exact. Chords are exact for settled wheels, otherwise their error falls with the
    square of the time."""
    share = 1.0  # completed fraction of the change of the wheels' speeds
    for i in range(body.shape[1]):
        lag = body[LAG, i]
        heading = body[HEADING, i]
        left_target = body[LEFT_TARGET, i]
        right_target = body[RIGHT_TARGET, i]
        if i == 0 or lag != body[LAG, i - 1]:
            share = 1.0 if lag == 0 else -math.expm1(seconds / -lag)
        # the speeds approach their targets exponentially: how much is missing now, and then
        left_missing = body[LEFT, i] - left_target
        right_missing = body[RIGHT, i] - right_target
        body[LEFT, i] = left_target + left_missing * (1 - share)
        body[RIGHT, i] = right_target + right_missing * (1 - share)
        fastest = max(abs(body[LEFT, i]), abs(body[RIGHT, i]))
        if left_target == 0 and right_target == 0 and fastest < body[STANDS_BELOW, i]:
            body[LEFT, i] = 0.0
            body[RIGHT, i] = 0.0
        left_way = left_target * seconds + lag * left_missing * share
        right_way = right_target * seconds + lag * right_missing * share
        angle = body[TURNS, i] * (right_way - left_way)  # (23)
        east, north = rolled(heading, angle, body[MOVES, i] * (right_way + left_way))  # (21), (22)
        body[X, i] += east
        body[Y, i] += north
        body[HEADING, i] = heading + angle

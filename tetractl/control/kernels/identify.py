"""Dead time, turning rates, speeds and heading biases: the twin of `tetractl.control.identify.fit`.

A fit of few intervals is a loop over robots, intervals and the directions that act in them; NumPy
spends more on calls than on numbers. What differs from the readable fit is the order of sums, and
the normal equations: all robots have the dead time in common and nothing else, so that the inverse
is had from one 2 x 2 matrix a robot.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tetractl.control.identify import Directions, Intervals, Prior
from tetractl.control.kernels.cache import compiled
from tetractl.control.kernels.options import KERNEL, PIECE
from tetractl.control.kernels.turns import NUDGE, Data, find_first, residual, residuals
from tetractl.core.plan import Estimate
from tetractl.core.poses import Floats

TRAVEL_STD = 0.01  # of a measured distance, in seconds of travel [s]
CAUCHY = 2.385  # C: 95 % of the efficiency of least squares where no residual is an outlier
FACTOR_MAX = 5.0  # a and speed stay within this factor of the prior's
LN_FACTOR_MAX = math.log(FACTOR_MAX)
SURE_S = 0.012  # deviation of the dead time from which on no grid is looked at [s]
GRID_STEP_S = 0.02
LOOK_LEAST = 8  # intervals from which on their doubling is a reason to look again
LOOK_MAX = 80  # intervals that a look over the grid takes into account at most, the latest
NUDGE_S = 0.002  # of tau [s], for derivatives
SCALE_WEIGHT = 20  # residuals that the scale before anything is seen counts for

THERE, MORE_A, LESS_TAU, MORE_TAU, MORE_BETA = range(5)
"""The points near one of the parameters, in the order of `identify._Turns.near`."""


class Work(NamedTuple):
    """The arrays that a fit of K intervals of N robots works in."""

    ln_a: Floats  # (N,)
    beta: Floats  # (N,)
    first: NDArray[np.int64]  # (3, K) direction that acts at the begin, for three dead times
    near: Floats  # (N, 5, K) residuals near a point, over the unscaled sigma
    some: Floats  # (K N,)
    step: Floats  # (4, N) of ln a and beta with tau held, and how much less each for a step of tau
    look: Floats  # (2, N) ln a and beta at a dead time of the grid


def fit(
    intervals: Intervals,
    directions: Directions,
    prior: Prior,
    guess: Estimate,
    lanes: Any,
    iterations: int = 2,
) -> Estimate:
    """Return what `identify.fit` does to rounding; `lanes` are constants of the motion, `Lanes`,
    whose class decides how the robots turn.

    Arrays have to be contiguous, for one kernel to serve them all.
    """
    if not len(intervals.since) or not len(directions.u):
        return guess
    count = len(prior.a)
    before, found = np.empty((3, count)), np.empty((6, count))
    before[0], before[1], before[2] = guess.a, guess.speed, guess.heading_bias
    tau, tau_std = _fit(
        lanes,
        Data(*intervals, *directions),
        prior,
        guess.dead_time,
        guess.dead_time_std,
        before,
        iterations,
        found,
    )
    return Estimate(*found, dead_time=tau, dead_time_std=tau_std)


@compiled(**KERNEL)
def _fit(lanes, data, prior, tau, tau_std, guess, iterations, found):
    """Fit from a guess (3, N) of a, speed and heading bias; return the dead time, its deviation.

    found (6, N) is filled with a, speed and heading bias, each followed by its deviation.
    """
    intervals, robots = data.turned.shape
    work = Work(
        np.empty(robots),
        np.empty(robots),
        np.empty((3, intervals), dtype=np.int64),
        np.empty((robots, 5, intervals)),
        np.empty(intervals * robots),
        np.empty((4, robots)),
        np.empty((2, robots)),
    )
    for i in range(robots):
        work.ln_a[i], work.beta[i] = math.log(guess[0, i] / prior.a[i]), guess[2, i]
    doubled = intervals >= LOOK_LEAST and intervals & (intervals - 1) == 0
    look, scale, steps = tau_std > SURE_S or doubled, 0.0, 0
    while steps < iterations:
        _find_near(lanes, data, prior, work, tau)
        if scale == 0:
            scale = _scale(data, work)
        if look:
            tau, look = _look(lanes, data, prior, work, tau, scale), False
        else:
            tau, tau_std = _improve(prior, work, tau, scale, found)
            steps += 1
    for i in range(robots):
        found[0, i] = prior.a[i] * math.exp(work.ln_a[i])
        found[1, i] *= found[0, i]
        found[2, i], found[3, i] = _fit_speed(data, prior, guess[1, i], i)
        found[4, i] = work.beta[i]
    return tau, tau_std


@compiled(**PIECE)
def _within(value, most):
    return min(max(value, -most), most)


@compiled(**PIECE)
def _weight(r):
    """Return Cauchy's weight of a residual over its sigma."""
    return 1 / (1 + (r / CAUCHY) ** 2)


@compiled(**PIECE)
def _find_near(lanes, data, prior, work, tau):
    """Fill work.near."""
    find_first(data, tau, work.first[0])
    find_first(data, max(0.0, tau - NUDGE_S), work.first[1])
    find_first(data, tau + NUDGE_S, work.first[2])
    for i in range(prior.a.size):
        near, beta = work.near[i], work.beta[i]
        a, more_a = prior.a[i] * math.exp(work.ln_a[i]), prior.a[i] * math.exp(work.ln_a[i] + NUDGE)
        for k in range(data.since.size):
            if not data.usable[k, i]:
                for point in range(5):
                    near[point, k] = 0.0
                continue
            near[THERE, k], near[MORE_A, k], near[MORE_BETA, k] = residuals(
                lanes, data, work.first[0, k], tau, k, i, a, more_a, beta
            )
            for which in range(2):
                when = max(0.0, tau - NUDGE_S) if which == 0 else tau + NUDGE_S
                r = residual(lanes, data, work.first[1 + which, k], when, k, i, a, beta)
                near[LESS_TAU + which, k] = r


@compiled(**PIECE)
def _scale(data, work):
    """Return s from the median of the residuals, shrunk towards 1 while they are few."""
    count = 0
    for i in range(data.usable.shape[1]):
        for k in range(data.usable.shape[0]):
            if data.usable[k, i]:
                work.some[count] = abs(work.near[i, THERE, k])
                count += 1
    if count == 0:
        return 1.0
    median = _median(work.some, count) / 0.6745
    return max(0.02, math.sqrt((SCALE_WEIGHT + count * median**2) / (SCALE_WEIGHT + count)))


@compiled(**PIECE)
def _median(values, count):
    """Return the median of the first `count` values, by Hoare's selection, which reorders them."""
    middle, low, high = count // 2, 0, count - 1
    while low < high:
        pivot, i, j = values[middle], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if j < middle:
            low = i
        if middle < i:
            high = j
    if count % 2:
        return values[middle]
    below = values[0]
    for i in range(1, middle):
        below = max(below, values[i])
    return (below + values[middle]) / 2


@compiled(**PIECE)
def _look(lanes, data, prior, work, tau, scale):
    """Leave the best a and beta of a grid of dead times in `work`; return the dead time.

    The one believed in comes first: where some robots miss by more already, the others are not
    fitted.
    """
    low = max(0.0, prior.dead_time - 3 * prior.dead_time_std)
    high = prior.dead_time + 3 * prior.dead_time_std + 1e-9
    least, best = math.inf, tau
    for g in range(math.ceil((high - low) / GRID_STEP_S) + 1):
        at = tau if g == 0 else low + (g - 1) * GRID_STEP_S
        total = ((at - prior.dead_time) / prior.dead_time_std) ** 2 / 2
        find_first(data, at, work.first[0])
        for i in range(prior.a.size):
            if total <= least:
                total += _fit_robot(lanes, data, prior, work, at, scale, i)
        if total < least:
            least, best = total, at
            for i in range(prior.a.size):
                work.ln_a[i], work.beta[i] = work.look[0, i], work.look[1, i]
    return best


@compiled(**PIECE)
def _fit_robot(lanes, data, prior, work, tau, scale, i):
    """Leave a and beta of robot i at a dead time in work.look; return its share of the least."""
    ln_a, beta, total = 0.0, 0.0, 0.0
    start = max(0, data.since.size - LOOK_MAX)
    for step in range(4):
        aa, bb = prior.a_std**-2, prior.heading_bias_std**-2
        ga, gb, ab = -ln_a * aa, -beta * bb, 0.0
        total = (ln_a * ln_a * aa + beta * beta * bb) / 2
        a, more_a = prior.a[i] * math.exp(ln_a), prior.a[i] * math.exp(ln_a + NUDGE)
        for k in range(start, data.since.size):
            if not data.usable[k, i]:
                continue
            at = work.first[0, k]
            if step == 3:
                r = residual(lanes, data, at, tau, k, i, a, beta) / scale
                total += CAUCHY**2 / 2 * math.log1p((r / CAUCHY) ** 2)
                continue
            r, by_a, by_beta = residuals(lanes, data, at, tau, k, i, a, more_a, beta)
            by_a, by_beta, r = (
                (r - by_a) / (scale * NUDGE),
                (r - by_beta) / (scale * NUDGE),
                r / scale,
            )
            w = _weight(r)
            aa += w * by_a * by_a
            bb += w * by_beta * by_beta
            ab += w * by_a * by_beta
            ga += w * by_a * r
            gb += w * by_beta * r
        if step < 3:
            det = aa * bb - ab * ab
            ln_a = _within(ln_a + _within((bb * ga - ab * gb) / det, 0.3), LN_FACTOR_MAX)
            beta += _within((aa * gb - ab * ga) / det, 0.3)
    work.look[0, i], work.look[1, i] = ln_a, beta
    return total


@compiled(**PIECE)
def _improve(prior, work, tau, scale, found):
    """Do a Gauss-Newton step; return tau and its deviation, and leave ln a and beta in `work`.

    found[1] and found[5] are filled with the deviations of ln a and beta. With the 2 x 2 matrix M
    of a robot, its column c in the row of tau, and its right side g, the step of tau is

        (g_tau - sum c' M^-1 g) / S,     S = its own entry - sum c' M^-1 c,

    that of the robot M^-1 (g - c times the step of tau), and the variances are 1 / S and the
    diagonal of M^-1 + (M^-1 c)(M^-1 c)' / S.
    """
    span = tau + NUDGE_S - max(0.0, tau - NUDGE_S)
    tt = prior.dead_time_std**-2
    gt = -(tau - prior.dead_time) * tt
    for i in range(prior.a.size):
        near = work.near[i]
        aa, bb = prior.a_std**-2, prior.heading_bias_std**-2
        ga, gb, ab, ta, tb = -work.ln_a[i] * aa, -work.beta[i] * bb, 0.0, 0.0, 0.0
        for k in range(near.shape[1]):
            r = near[THERE, k] / scale
            by_a = (near[THERE, k] - near[MORE_A, k]) / (scale * NUDGE)
            by_beta = (near[THERE, k] - near[MORE_BETA, k]) / (scale * NUDGE)
            by_tau = (near[LESS_TAU, k] - near[MORE_TAU, k]) / (scale * span)
            w = _weight(r)
            aa += w * by_a * by_a
            bb += w * by_beta * by_beta
            ab += w * by_a * by_beta
            ta += w * by_tau * by_a
            tb += w * by_tau * by_beta
            tt += w * by_tau * by_tau
            ga += w * by_a * r
            gb += w * by_beta * r
            gt += w * by_tau * r
        det = aa * bb - ab * ab
        a_by_tau, beta_by_tau = (bb * ta - ab * tb) / det, (aa * tb - ab * ta) / det  # M^-1 c
        tt -= ta * a_by_tau + tb * beta_by_tau
        gt -= ga * a_by_tau + gb * beta_by_tau
        work.step[0, i], work.step[1, i] = (bb * ga - ab * gb) / det, (aa * gb - ab * ga) / det
        work.step[2, i], work.step[3, i] = a_by_tau, beta_by_tau
        found[1, i], found[5, i] = bb / det, aa / det
    change = gt / tt
    for i in range(prior.a.size):
        a_by_tau, beta_by_tau = work.step[2, i], work.step[3, i]
        by_a = _within(work.step[0, i] - a_by_tau * change, 0.3)
        work.ln_a[i] = _within(work.ln_a[i] + by_a, LN_FACTOR_MAX)
        work.beta[i] += _within(work.step[1, i] - beta_by_tau * change, 0.3)
        found[1, i] = math.sqrt(found[1, i] + a_by_tau * a_by_tau / tt)
        found[5, i] = math.sqrt(found[5, i] + beta_by_tau * beta_by_tau / tt)
    most = prior.dead_time + 4 * prior.dead_time_std
    return min(max(tau + _within(change, 0.03), 0.0), most), math.sqrt(1 / tt)


@compiled(**PIECE)
def _fit_speed(data, prior, speed, i):
    """Return the speed of robot i and its deviation, from distances and measured turns."""
    sigma = TRAVEL_STD * prior.speed[i]
    prior_var = (prior.speed_std * prior.speed[i]) ** 2 + 1e-300
    var = prior_var
    for _ in range(2):
        total, right = 1 / prior_var, prior.speed[i] / prior_var
        for k in range(data.since.size):
            half = data.turned[k, i] / 2
            if data.usable[k, i] and abs(half) < math.pi / 4:
                t = data.until[k] - data.since[k]
                by_speed = t * (math.sin(half) / half if half != 0 else 1.0)
                travelled = data.travelled[k, i]
                r = (travelled - by_speed * speed) / (sigma + 1e-300)
                w = _weight(r) / (sigma * sigma + 1e-300)
                total += w * by_speed * by_speed
                right += w * by_speed * travelled
        var = 1 / total
        speed = var * right
    low, high = prior.speed[i] / FACTOR_MAX, prior.speed[i] * FACTOR_MAX
    return min(max(speed, low), high), math.sqrt(var)

"""The compiled part of `tetractl.control.filter`; `tests/oracles/filter.py` is its readable twin.

The state of a robot is (x, y, heading of its course, ln of a and of the speed over the spec's, turn
bias, marker bias, flow along x and y, helix as sine and cosine), in the order of the indices below.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tetractl.control.kernels.cache import compiled
from tetractl.control.kernels.options import ENTRY_FAST, INLINE_FAST, inlined
from tetractl.core.poses import Floats
from tetractl.model.motion.polynomials import wrap

X, Y, HEADING, LN_A, LN_V, BIAS, MARKER, FLOW_X, FLOW_Y, SINE, COSINE = range(11)
SIZE = 11  # number of state variables with a covariance
SWING, PACE = 11, 12  # turning rate / a and speed / v of lagging wheels, without variance
STATE = 13  # number of state variables
STILL = 1e-3  # pace below which a stopped robot counts as standing
FOLLOWS = 3  # number of latest commands that a robot may follow
STUCK = FOLLOWS  # slot of the hypothesis that a robot stands although it was sent a direction
SLOTS = FOLLOWS + 1
SUBSTEP_S = 0.025  # longest step of the prediction
LOST = 0.05  # probability that a command does not arrive
STUCK_EVERY_S, STUCK_FOR_S = 30.0, 0.5  # mean time until a robot gets stuck, and mean duration
GATE = 30.0  # squared deviation above which a measurement is an outlier
LEAST_WEIGHT = -25.0  # least ln of a hypothesis's weight
LOST_TRACK_S = 0.3  # time without a fitting hypothesis after which the camera's pose is used [s]
SCALE_MEMORY = 400.0  # number of frames over which the noise is averaged
FORGET_S = 10.0  # time constant with which scores of dead times decay
SCALE_LEAST, SCALE_MOST = 1e-3, 10.0  # range of the ratio of observed to expected variances
MEAN_CAPPED = 0.8  # mean of the square of a standard normal number, capped at 4
_wrap = inlined(wrap)


class FilterModel(NamedTuple):
    """The prior on N robots; `noise` and `walk` are standard deviations."""

    a: Floats  # (N,) rad/s
    speed: Floats  # (N,) length unit/s
    noise: Floats  # (3, N) of measured x, y [length unit] and heading [rad]
    walk: Floats  # (SIZE, N) deviation of the state's random walk [1/sqrt(s)]
    helix: float  # its angular frequency [rad/s]
    lag: float  # time constant with which turning rate and speed follow a direction [s]


class Bank(NamedTuple):
    """B filters, each with its own dead time and SLOTS hypotheses for each of N robots."""

    state: Floats  # (B, N, SLOTS, STATE)
    cov: Floats  # (B, N, SLOTS, SIZE, SIZE)
    u: Floats  # (B, N, SLOTS) direction followed [rad], NaN for a robot that stands
    weight: Floats  # (B, N, SLOTS) ln of the probability, -inf if there is none
    scale: Floats  # (B, N, 2) ratio of observed to expected variances of positions and headings
    unfit: Floats  # (B, N) time since a hypothesis fitted [s]
    tau: Floats  # (B,) dead time [s]
    score: Floats  # (B,) ln of the likelihood, up to a constant
    next: NDArray[np.int64]  # (B,) index of the command that acts next


@compiled(**INLINE_FAST)
def _advance(model, i, z, cov, u, scale, seconds):
    """Predict state and covariance of one hypothesis of robot i by (1)-(3), by the midpoint rule.

    Lagging wheels follow the turning rate that the host sends, computed for the heading in which
    the robot would come to rest (`tetractl.model.wheels.LaggingTurns`).
    """
    left, lag, drives = seconds, model.lag, not math.isnan(u)
    goal = 1.0 if drives else 0.0
    if not drives and (lag == 0 or z[PACE] < STILL):
        z[SWING] = z[PACE] = 0.0
    while left > 0:
        t = min(left, SUBSTEP_S)
        left -= SUBSTEP_S
        if drives or z[PACE] > 0:
            a, v = model.a[i] * math.exp(z[LN_A]), model.speed[i] * math.exp(z[LN_V])
            wish, pull = 0.0, 0.0
            early = math.exp(-0.5 * t / lag) if lag > 0 else 0.0
            late = early * early
            off = u + z[BIAS] - z[HEADING] - lag * a * z[SWING]
            if drives:
                wish = math.sin(off)
            half = a * (0.5 * t * wish + lag * (1 - early) * (z[SWING] - wish))
            middle, off = z[HEADING] + half, off - 0.5 * t * a * wish
            if drives:
                wish, pull = math.sin(off), math.cos(off)
            turn = a * (t * wish + lag * (1 - late) * (z[SWING] - wish))
            way = v * (t * goal + lag * (1 - late) * (z[PACE] - goal)) * (1 - turn * turn / 24)
            z[SWING] = wish + late * (z[SWING] - wish)
            z[PACE] = goal + late * (z[PACE] - goal)
            keep = math.exp(-t * a * pull)
            dx, dy = way * math.cos(middle), way * math.sin(middle)  # a chord
            z[X] += dx + t * z[FLOW_X]
            z[Y] += dy + t * z[FLOW_Y]
            z[HEADING] += turn
            # derivatives of the heading in the middle
            by_h, by_a, by_b = (
                0.5 * (1 + keep),
                half,
                0.5 * (1 - keep),
            )
            for k in range(SIZE):  # rows of F P
                h, la, b = cov[HEADING, k], cov[LN_A, k], cov[BIAS, k]
                m = by_h * h + by_a * la + by_b * b
                cov[X, k] += -dy * m + dx * cov[LN_V, k] + t * cov[FLOW_X, k]
                cov[Y, k] += dx * m + dy * cov[LN_V, k] + t * cov[FLOW_Y, k]
                cov[HEADING, k] = keep * h + turn * la + (1 - keep) * b
            for k in range(SIZE):  # columns of (F P) F'
                h, la, b = cov[k, HEADING], cov[k, LN_A], cov[k, BIAS]
                m = by_h * h + by_a * la + by_b * b
                cov[k, X] += -dy * m + dx * cov[k, LN_V] + t * cov[k, FLOW_X]
                cov[k, Y] += dx * m + dy * cov[k, LN_V] + t * cov[k, FLOW_Y]
                cov[k, HEADING] = keep * h + turn * la + (1 - keep) * b
            if model.helix > 0:
                c, s = math.cos(model.helix * t), math.sin(model.helix * t)
                z[SINE], z[COSINE] = c * z[SINE] + s * z[COSINE], c * z[COSINE] - s * z[SINE]
                for k in range(SIZE):
                    p, q = cov[SINE, k], cov[COSINE, k]
                    cov[SINE, k], cov[COSINE, k] = c * p + s * q, c * q - s * p
                for k in range(SIZE):
                    p, q = cov[k, SINE], cov[k, COSINE]
                    cov[k, SINE], cov[k, COSINE] = c * p + s * q, c * q - s * p
            for k in range(SIZE):
                more = model.walk[k, i] * model.walk[k, i] * t
                if k <= Y:
                    more *= scale[0]
                elif k == HEADING:
                    more *= scale[1]
                cov[k, k] += more


@compiled(**INLINE_FAST)
def _correct(z, cov, n, index, factor, off, var):
    """Update by a measured number that differs by `off` from its prediction h z; h has n entries
    h[index] = factor.

    P is updated in Joseph's form, (1 - k h) P (1 - k h)' + k var k': after a long time without a
    fit, P is many orders larger than `var`, and by rounding P - k h P would not be a covariance.
    Returns the number's variance before the update.
    """
    gain = np.empty(SIZE)
    total = var
    for k in range(SIZE):
        value = 0.0
        for j in range(n):
            value += cov[k, index[j]] * factor[j]
        gain[k] = value
    for j in range(n):
        total += factor[j] * gain[index[j]]
    for k in range(SIZE):
        share, left = gain[k] / total, 0.0
        z[k] += share * off
        for m in range(SIZE):
            cov[k, m] -= share * gain[m]
        for j in range(n):
            left += cov[k, index[j]] * factor[j]
        for m in range(SIZE):
            cov[k, m] += (var * share - left) * (gain[m] / total)
    for k in range(SIZE):
        for m in range(k):
            cov[k, m] = cov[m, k] = 0.5 * (cov[k, m] + cov[m, k])
    return total


@compiled(**INLINE_FAST)
def _measure(model, i, z, cov, scale, pose, squares):
    """Update one hypothesis by a pose (3,); return the logarithm of the pose's likelihood.

    `squares` (2,) is filled with the mean squared deviations of position and heading, relative to
    their variances; an outlier has the likelihood of a pose at the gate.
    """
    index, factor = np.empty(3, dtype=np.int64), np.empty(3)
    c, s, n = math.cos(z[HEADING]), math.sin(z[HEADING]), 1 if model.helix == 0 else 2
    rate = model.helix / (model.speed[i] * math.exp(z[LN_V]) + 1e-300)
    off = np.empty(3)
    off[0] = pose[0] - z[X] + s * z[SINE]
    off[1] = pose[1] - z[Y] - c * z[SINE]
    off[2] = _wrap(pose[2] - z[HEADING] - z[MARKER] - rate * z[COSINE])
    var = np.empty(3)
    for j in range(3):
        var[j] = model.noise[j, i] ** 2 * scale[0 if j < 2 else 1]
    sure, lns = np.empty(3), 0.0
    sure[0] = cov[X, X] - 2 * s * cov[X, SINE] + s * s * cov[SINE, SINE] + var[0]
    sure[1] = cov[Y, Y] + 2 * c * cov[Y, SINE] + c * c * cov[SINE, SINE] + var[1]
    sure[2] = (
        cov[HEADING, HEADING]
        + cov[MARKER, MARKER]
        + 2 * cov[HEADING, MARKER]
        + rate * (2 * cov[HEADING, COSINE] + 2 * cov[MARKER, COSINE] + rate * cov[COSINE, COSINE])
        + var[2]
    )
    d2 = 0.0
    for j in range(3):
        d2 += off[j] * off[j] / sure[j]
        lns += math.log(sure[j])
    squares[0] = 0.5 * (off[0] * off[0] / sure[0] + off[1] * off[1] / sure[1])
    squares[1] = off[2] * off[2] / sure[2]
    if not d2 <= GATE:
        return -0.5 * (GATE + lns)
    found = 0.0
    for j in range(3):
        if j == 0:
            index[0], factor[0], index[1], factor[1] = X, 1.0, SINE, -s
            miss = pose[0] - z[X] + s * z[SINE]
        elif j == 1:
            index[0], factor[0], index[1], factor[1] = Y, 1.0, SINE, c
            miss = pose[1] - z[Y] - c * z[SINE]
        else:
            index[0], factor[0], index[1], factor[1] = HEADING, 1.0, MARKER, 1.0
            index[2], factor[2], n = COSINE, rate, n + 1
            miss = _wrap(pose[2] - z[HEADING] - z[MARKER] - rate * z[COSINE])
        total = _correct(z, cov, n, index, factor, miss, var[j])
        found -= 0.5 * (miss * miss / total + math.log(total))
    return found


@compiled(**INLINE_FAST)
def _copy(bank, b, i, source, slot):
    """Copy the state of one hypothesis to another."""
    for k in range(STATE):
        bank.state[b, i, slot, k] = bank.state[b, i, source, k]
    for k in range(SIZE):
        for m in range(SIZE):
            bank.cov[b, i, slot, k, m] = bank.cov[b, i, source, k, m]


@compiled(**INLINE_FAST)
def _best(weight, most):
    """Return the slot, of the first `most`, with the greatest weight."""
    found = 0
    for s in range(1, most):
        if weight[s] > weight[found]:
            found = s
    return found


@compiled(**INLINE_FAST)
def _rate(model, i, z, u):
    """Return how fast robot i turns under direction u [rad/s]."""
    if math.isnan(u):
        return 0.0
    return model.a[i] * math.exp(z[LN_A]) * math.sin(u + z[BIAS] - z[HEADING])


@compiled(**INLINE_FAST)
def _switch(bank, model, b, i, u, step):
    """Add the hypotheses that robot i follows direction u [rad] from now on, or did not receive it.

    The time at which u acts is uncertain by `step`, the spacing of the bank's dead times [s].
    """
    weight, held = bank.weight[b, i], bank.u[b, i]
    best = _best(weight, FOLLOWS)
    most = weight[best]
    place = 0
    for s in range(FOLLOWS):
        if held[s] == u and weight[s] > -math.inf:  # the direction is the same as before
            if weight[s] < most + math.log(1 - LOST):
                _copy(bank, b, i, best, s)
                weight[s] = most + math.log(1 - LOST)
            return
        if weight[s] < weight[place]:
            place = s
    if place != best:
        _copy(bank, b, i, best, place)
    for s in range(FOLLOWS):
        weight[s] += math.log(LOST)
    z, cov = bank.state[b, i, place], bank.cov[b, i, place]
    speed = model.speed[i] * math.exp(z[LN_V])
    before, after = _rate(model, i, z, held[best]), _rate(model, i, z, u)
    cov[HEADING, HEADING] += (step * (after - before)) ** 2 / 12
    if math.isnan(held[best]) != math.isnan(u):
        cov[X, X] += (step * speed) ** 2 / 12
        cov[Y, Y] += (step * speed) ** 2 / 12
    held[place], weight[place] = u, most + math.log(1 - LOST)


@compiled(**INLINE_FAST)
def _stick(bank, b, i, seconds):
    """Exchange probability between the hypotheses that robot i drives and that it is stuck."""
    weight, held = bank.weight[b, i], bank.u[b, i]
    best = _best(weight, FOLLOWS)
    if math.isnan(held[best]):
        weight[STUCK] = -math.inf
        return
    share = min(0.5, seconds / STUCK_FOR_S)
    stays, free = weight[STUCK] + math.log(1 - share), weight[STUCK] + math.log(share)
    sticks = weight[best] + math.log(min(0.5, seconds / STUCK_EVERY_S))
    if free > weight[best]:
        _copy(bank, b, i, STUCK, best)
        weight[best] = free
    elif sticks > stays:
        _copy(bank, b, i, best, STUCK)
        stays = sticks
    weight[STUCK] = stays


@compiled(**INLINE_FAST)
def _weigh(bank, b, i, model, pose, seconds):
    """Update all hypotheses of robot i by a pose; return the logarithm of the pose's likelihood."""
    weight, scale = bank.weight[b, i], bank.scale[b, i]
    squares, best_squares = np.zeros(2), np.full(2, np.inf)
    most = -math.inf
    for s in range(SLOTS):
        if weight[s] == -math.inf:
            continue
        z, cov = bank.state[b, i, s], bank.cov[b, i, s]
        weight[s] += _measure(model, i, z, cov, scale, pose, squares)
        if weight[s] > most:
            most = weight[s]
            best_squares[0], best_squares[1] = squares[0], squares[1]
    total = 0.0
    for s in range(SLOTS):
        total += math.exp(weight[s] - most)
    total = most + math.log(total)
    for s in range(SLOTS):
        if weight[s] > -math.inf:
            weight[s] = max(weight[s] - total, LEAST_WEIGHT)
    if 2 * best_squares[0] + best_squares[1] <= GATE:
        bank.unfit[b, i] = 0.0
        for k in range(2):
            change = min(best_squares[k], 4.0) / MEAN_CAPPED - 1
            scale[k] = min(max(scale[k] * (1 + change / SCALE_MEMORY), SCALE_LEAST), SCALE_MOST)
    else:
        bank.unfit[b, i] += seconds
        if bank.unfit[b, i] > LOST_TRACK_S:
            place(bank, b, i, model, pose)
    return total


@compiled(**ENTRY_FAST)
def place(bank, b, i, model, pose):
    """Set the pose of every hypothesis of robot i to a measured pose (3,)."""
    bank.unfit[b, i] = 0.0
    for s in range(SLOTS):
        z, cov = bank.state[b, i, s], bank.cov[b, i, s]
        z[X], z[Y] = pose[0], pose[1]
        z[HEADING] += _wrap(pose[2] - z[MARKER] - z[HEADING])
        for j in range(3):
            for k in range(SIZE):
                cov[j, k] = cov[k, j] = 0.0
            cov[j, j] = 4 * model.noise[j, i] ** 2


@compiled(**ENTRY_FAST)
def follow(bank, model, step, since, until, when, u, poses, seen):
    """Predict every filter from `since` to `until` [s] and update it by the poses of a frame.

    Commands u (C,) [rad], NaN for a stop, were sent at times when (C,) [s]. poses (N, 3) are
    measured; only those with `seen` (N,) True are used. Returns ln of their likelihoods (B, N).
    """
    found = np.zeros(bank.unfit.shape)
    for b in range(bank.tau.size):
        t = since
        while t < until:
            coming = bank.next[b]
            acts = when[coming] + bank.tau[b] if coming < when.size else math.inf
            end = max(t, min(acts, until))
            for i in range(model.a.size):
                for s in range(SLOTS):
                    if bank.weight[b, i, s] > -math.inf:
                        z, cov = bank.state[b, i, s], bank.cov[b, i, s]
                        _advance(model, i, z, cov, bank.u[b, i, s], bank.scale[b, i], end - t)
                if acts <= until:
                    _switch(bank, model, b, i, u[coming], step)
            if acts <= until:
                bank.next[b] += 1
            t = end
            if acts > until:
                break
        for i in range(model.a.size):
            if seen[i]:
                found[b, i] = _weigh(bank, b, i, model, poses[i], until - since)
            _stick(bank, b, i, until - since)
        bank.score[b] += found[b].sum()
    bank.score[:] = (bank.score - bank.score.max()) * math.exp(-(until - since) / FORGET_S)
    return found


@compiled(**ENTRY_FAST)
def drive(model, states, u, seconds):
    """Predict states (N, STATE) in place through directions u (C, N), each held for `seconds` (C,).

    The robots' wheels then stop: the states are those in which the robots come to rest.
    """
    scale = np.zeros(2)
    for i in range(model.a.size):
        cov = np.zeros((SIZE, SIZE))
        for c in range(seconds.size):
            _advance(model, i, states[i], cov, u[c, i], scale, seconds[c])
        z = states[i]
        turn = model.lag * model.a[i] * math.exp(z[LN_A]) * z[SWING]
        way = model.lag * model.speed[i] * math.exp(z[LN_V]) * z[PACE]
        half = 0.5 * turn
        chord = way * (1 - half * half / 6)
        z[X] += chord * math.cos(z[HEADING] + half)
        z[Y] += chord * math.sin(z[HEADING] + half)
        z[HEADING] += turn

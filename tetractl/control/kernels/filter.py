"""The compiled part of `tetractl.control.filter`, whose readable twin is
`tests/oracles/filter.py`."""

import math

import numpy as np

from tetractl.control.kernels.cache import compiled
from tetractl.control.kernels.filter_state import (
    ASSUMED,
    BIAS,
    COSINE,
    FLOW_X,
    FLOW_Y,
    FOLLOWS,
    HEADING,
    LN_A,
    LN_V,
    LN_W,
    MARKER,
    MOVED,
    PACE,
    SINE,
    SIZE,
    SLOTS,
    STUCK,
    SWING,
    X,
    Y,
)
from tetractl.control.kernels.options import ENTRY_FAST, INLINE_FAST, inlined
from tetractl.model.motion.polynomials import wrap

_wrap = inlined(wrap)


@compiled(**INLINE_FAST)
def advance(model, i, z, cov, u, scale, seconds):
    """Predict state and covariance of one hypothesis of robot i by (1)-(3), by the midpoint rule;
    without a covariance, None, the compiler leaves out what it needs.

    Lagging wheels follow the turning rate that the host sends, computed for the heading in which
    the robot would come to rest (`tetractl.model.wheels.LaggingTurns`).
    """
    left, lag, drives = seconds, model.lag, not math.isnan(u)
    goal = 1.0 if drives else 0.0
    if not drives and (lag == 0 or z[PACE] < ASSUMED.still):
        z[SWING] = z[PACE] = 0.0
    slopes = np.zeros((MOVED, SIZE))  # of the change of the moved states
    while left > 0 and (drives or z[PACE] > 0):
        t = min(left, ASSUMED.substep_s)
        left -= ASSUMED.substep_s
        a, v = model.a[i] * math.exp(z[LN_A]), model.speed[i] * math.exp(z[LN_V])
        early = math.exp(-0.5 * t / lag) if lag > 0 else 0.0
        late = early * early
        off = u + z[BIAS] - z[HEADING] - lag * a * z[SWING]
        wish = math.sin(off) if drives else 0.0
        half = a * (0.5 * t * wish + lag * (1 - early) * (z[SWING] - wish))
        middle, off = z[HEADING] + half, off - 0.5 * t * a * wish
        wish, pull = (math.sin(off), math.cos(off)) if drives else (0.0, 0.0)
        turn = a * (t * wish + lag * (1 - late) * (z[SWING] - wish))
        chord = 1 - turn * turn / 24
        way = v * (t * goal + lag * (1 - late) * (z[PACE] - goal)) * chord
        z[SWING] = wish + late * (z[SWING] - wish)
        z[PACE] = goal + late * (z[PACE] - goal)
        keep = math.exp(-t * a * pull)
        dx, dy = way * math.cos(middle), way * math.sin(middle)
        z[X] += dx + t * z[FLOW_X]
        z[Y] += dy + t * z[FLOW_Y]
        z[HEADING] += turn
        for row, by in ((X, -dy), (Y, dx)):  # by the heading in the middle
            slopes[row, HEADING], slopes[row, BIAS] = 0.5 * by * (1 + keep), 0.5 * by * (1 - keep)
            slopes[row, LN_A] = by * half
        slopes[X, LN_V], slopes[Y, LN_V] = dx, dy
        slopes[X, FLOW_X] = slopes[Y, FLOW_Y] = t
        slopes[HEADING, HEADING], slopes[HEADING, BIAS] = keep - 1, 1 - keep
        slopes[HEADING, LN_A] = turn
        if model.helix > 0:
            angle = t * model.helix * math.exp(z[LN_W])
            c, s = math.cos(angle), math.sin(angle)
            z[SINE], z[COSINE] = c * z[SINE] + s * z[COSINE], c * z[COSINE] - s * z[SINE]
            slopes[SINE, SINE], slopes[SINE, COSINE] = c - 1, s
            slopes[COSINE, SINE], slopes[COSINE, COSINE] = -s, c - 1
            slopes[SINE, LN_W], slopes[COSINE, LN_W] = angle * z[COSINE], -angle * z[SINE]
        if cov is not None:
            _spread(cov, slopes)
            for k in range(SIZE):
                factor = scale[0] if k <= Y else scale[1] if k == HEADING else 1.0
                cov[k, k] += factor * model.walk[k, i] * model.walk[k, i] * t


@compiled(**INLINE_FAST)
def _spread(cov, slopes):
    """Replace P by (1 + S) P (1 + S)' for the slopes S (MOVED, SIZE) of the moved states."""
    more = np.zeros((MOVED, SIZE))
    for _ in range(2):  # rows, then columns, which are the rows of the transposed matrix
        for j in range(MOVED):
            for k in range(SIZE):
                more[j, k] = 0.0
            for m in range(SIZE):
                by = slopes[j, m]
                if by != 0.0:
                    for k in range(SIZE):
                        more[j, k] += by * cov[m, k]
        for j in range(MOVED):
            for k in range(SIZE):
                cov[j, k] += more[j, k]
        for j in range(SIZE):
            for k in range(j):
                cov[j, k], cov[k, j] = cov[k, j], cov[j, k]


@compiled(**INLINE_FAST)
def _expected(model, i, z, slopes):
    """Return the pose that a camera would measure; its slopes (3, SIZE) are filled."""
    c, s = math.cos(z[HEADING]), math.sin(z[HEADING])
    rate = model.helix * math.exp(z[LN_W]) / (model.speed[i] * math.exp(z[LN_V]) + 1e-300)
    across = rate * z[COSINE]
    flat = 1 / (1 + across * across)
    slopes[0, X] = slopes[1, Y] = slopes[2, HEADING] = slopes[2, MARKER] = 1.0
    slopes[0, SINE], slopes[1, SINE], slopes[2, COSINE] = -s, c, rate * flat
    slopes[0, HEADING], slopes[1, HEADING] = -c * z[SINE], -s * z[SINE]
    slopes[2, LN_W], slopes[2, LN_V] = across * flat, -across * flat
    tilt = math.atan(across)
    return z[X] - s * z[SINE], z[Y] + c * z[SINE], z[HEADING] + z[MARKER] + tilt


@compiled(**INLINE_FAST)
def _correct(z, cov, slope, off, var):
    """Update by a measured number that differs by `off` from its prediction, of the given slope
    (SIZE,) and variance; return the number's variance before the update.

    P is updated in Joseph's form, (1 - k h) P (1 - k h)' + k var k': after a long time without a
    fit, P is many orders larger than `var`, and by rounding P - k h P would not be a covariance.
    """
    gain, total = np.zeros(SIZE), var
    for k in range(SIZE):
        for j in range(SIZE):
            gain[k] += cov[k, j] * slope[j]
    for k in range(SIZE):
        total += slope[k] * gain[k]
    for k in range(SIZE):
        share, left = gain[k] / total, 0.0
        z[k] += share * off
        for m in range(SIZE):
            cov[k, m] -= share * gain[m]
        for j in range(SIZE):
            left += cov[k, j] * slope[j]
        for m in range(SIZE):
            cov[k, m] += (var * share - left) * (gain[m] / total)
    for k in range(SIZE):
        for m in range(k):
            cov[k, m] = cov[m, k] = 0.5 * (cov[k, m] + cov[m, k])
    return total


@compiled(**INLINE_FAST)
def _measure(model, i, z, cov, scale, pose, found):
    """Update one hypothesis by a pose (3,); return the logarithm of the pose's likelihood.

    `found` (3,) is filled with the innovations along and across the course and of the heading, over
    their deviations; an outlier has the likelihood of a pose at the gate.
    """
    slopes, before = np.zeros((3, SIZE)), np.empty(SIZE)
    for k in range(SIZE):
        before[k] = z[k]
    expected = _expected(model, i, z, slopes)
    c, s = math.cos(z[HEADING]), math.sin(z[HEADING])
    off, var, sure = np.empty(3), np.empty(3), np.empty(3)
    d2 = lns = 0.0
    for j in range(3):
        off[j] = pose[j] - expected[j] if j < 2 else _wrap(pose[j] - expected[j])
        var[j] = sure[j] = model.noise[j, i] ** 2 * scale[0 if j < 2 else 1]
        for k in range(SIZE):
            for m in range(SIZE):
                sure[j] += slopes[j, k] * cov[k, m] * slopes[j, m]
        d2 += off[j] * off[j] / sure[j]
        lns += math.log(sure[j])
    east, north = off[0] / math.sqrt(sure[0]), off[1] / math.sqrt(sure[1])
    found[0], found[1] = c * east + s * north, c * north - s * east
    found[2] = off[2] / math.sqrt(sure[2])
    if not d2 <= ASSUMED.gate:
        return -0.5 * (ASSUMED.gate + lns)
    ln = 0.0
    for j in range(3):
        miss = off[j]
        for k in range(SIZE):
            miss -= slopes[j, k] * (z[k] - before[k])
        total = _correct(z, cov, slopes[j], miss, var[j])
        ln -= 0.5 * (miss * miss / total + math.log(total))
    return ln


@compiled(**INLINE_FAST)
def _copy(bank, b, i, source, slot):
    """Copy the state of one hypothesis to another."""
    for k in range(bank.state.shape[3]):
        bank.state[b, i, slot, k] = bank.state[b, i, source, k]
    for k in range(SIZE):
        for m in range(SIZE):
            bank.cov[b, i, slot, k, m] = bank.cov[b, i, source, k, m]


@compiled(**INLINE_FAST)
def _rate(model, i, z, u):
    """Return how fast robot i turns under direction u [rad/s]."""
    rate = model.a[i] * math.exp(z[LN_A]) * math.sin(u + z[BIAS] - z[HEADING])
    return 0.0 if math.isnan(u) else rate


@compiled(**INLINE_FAST)
def _switch(bank, model, b, i, u, step, now):
    """Add the hypotheses that robot i follows u [rad] from `now` [s] on, or did not receive it.

    The time at which u acts is uncertain by `step`, the spacing of the bank's dead times [s].
    """
    weight, held, until = bank.weight[b, i], bank.u[b, i], bank.until[b, i]
    best, place = np.argmax(weight[:FOLLOWS]), np.argmin(weight[:FOLLOWS])
    heard = weight[best] + math.log(1 - ASSUMED.lost)
    for s in range(FOLLOWS):
        if held[s] == u and weight[s] > -math.inf:  # the direction is the same as before
            if weight[s] < heard:
                _copy(bank, b, i, best, s)
                weight[s] = heard
            until[s] = now + model.watchdog
            return
    _copy(bank, b, i, best, place)
    for s in range(FOLLOWS):
        weight[s] += math.log(ASSUMED.lost)
    z, cov = bank.state[b, i, place], bank.cov[b, i, place]
    before = held[best] if now < until[best] else math.nan
    changes = _rate(model, i, z, u) - _rate(model, i, z, before)
    cov[HEADING, HEADING] += (step * changes) ** 2 / 12
    if math.isnan(before) != math.isnan(u):
        speed = model.speed[i] * math.exp(z[LN_V])
        cov[X, X] += (step * speed) ** 2 / 12
        cov[Y, Y] += (step * speed) ** 2 / 12
    held[place], until[place], weight[place] = u, now + model.watchdog, heard


@compiled(**INLINE_FAST)
def _stick(bank, b, i, seconds, now):
    """Exchange probability between driving and being stuck, for the `seconds` before `now`."""
    weight = bank.weight[b, i]
    best = np.argmax(weight[:FOLLOWS])
    if math.isnan(bank.u[b, i, best]) or bank.until[b, i, best] <= now:
        weight[STUCK] = -math.inf
        return
    share = min(0.5, seconds / ASSUMED.stuck_for_s)
    stays, free = weight[STUCK] + math.log(1 - share), weight[STUCK] + math.log(share)
    sticks = weight[best] + math.log(min(0.5, seconds / ASSUMED.stuck_every_s))
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
    found, best, most = np.zeros(3), np.zeros(3), -math.inf
    for s in range(SLOTS):
        if weight[s] > -math.inf:
            z, cov = bank.state[b, i, s], bank.cov[b, i, s]
            weight[s] += _measure(model, i, z, cov, scale, pose, found)
            if weight[s] > most:
                most = weight[s]
                for k in range(3):
                    best[k] = found[k]
    total = most + math.log(np.exp(weight - most).sum())
    for s in range(SLOTS):
        if weight[s] > -math.inf:
            weight[s] = max(weight[s] - total, ASSUMED.least_weight)
    places, turns = best[0] ** 2 + best[1] ** 2, best[2] ** 2
    if places + turns <= ASSUMED.gate:
        bank.unfit[b, i] = 0.0
        for k in range(2):
            change = min(turns if k else 0.5 * places, 4.0) / ASSUMED.mean_capped - 1
            scale[k] = min(
                max(scale[k] * (1 + change / ASSUMED.scale_memory), ASSUMED.scale_least),
                ASSUMED.scale_most,
            )
        _test(bank.white[b, i], best)
    else:
        bank.unfit[b, i] += seconds
        if bank.unfit[b, i] > ASSUMED.lost_track_s:
            place(bank, b, i, model, pose)
    return total


@compiled(**INLINE_FAST)
def _test(white, found):
    """Add a frame's innovations (3,) to the present block; add a whole block to the former ones.

    If the model is right, innovations are independent, so that the squared sum of a block's
    innovations over their number is 1 in the mean, and chi-square over all blocks.
    """
    for j in range(3):
        white[0, j] += found[j]
    white[0, 3] += 1
    if white[0, 3] >= ASSUMED.block:
        for j in range(3):
            white[1, j] += min(white[0, j] ** 2 / ASSUMED.block, ASSUMED.most_square)
        white[1, 3] += 1
        for j in range(4):
            white[0, j] = 0.0


@compiled(**ENTRY_FAST)
def place(bank, b, i, model, pose):
    """Set the pose of every hypothesis of robot i to a measured pose (3,)."""
    bank.unfit[b, i] = 0.0
    for s in range(SLOTS):
        z, cov = bank.state[b, i, s], bank.cov[b, i, s]
        z[X], z[Y], z[HEADING] = pose[0], pose[1], pose[2] - z[MARKER]
        for j in (X, Y, HEADING):
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
    for i in range(model.a.size):
        for b in range(bank.tau.shape[0]):
            if bank.score[b, i] == -math.inf:
                continue
            t = since
            while t < until:
                coming, at = bank.next[b, i], math.inf
                if coming < when.size:
                    at = when[coming] + bank.tau[b, i]
                acts, end = at <= until, max(t, min(at, until))
                for s in range(SLOTS):
                    if bank.weight[b, i, s] > -math.inf:
                        z, cov, held = bank.state[b, i, s], bank.cov[b, i, s], bank.u[b, i, s]
                        stops = min(max(bank.until[b, i, s], t), end)
                        for way, time in ((held, stops - t), (math.nan, end - stops)):
                            if time > 0:
                                advance(model, i, z, cov, way, bank.scale[b, i], time)
                t = end
                if acts:
                    _switch(bank, model, b, i, u[coming], step, t)
                    bank.next[b, i] += 1
            if seen[i]:
                found[b, i] = _weigh(bank, b, i, model, poses[i], until - since)
                bank.score[b, i] += found[b, i]
            _stick(bank, b, i, until - since, until)
        most, memory = -math.inf, math.exp(-(until - since) / ASSUMED.forget_s)
        for b in range(bank.tau.shape[0]):
            most = max(most, bank.score[b, i])
        for b in range(bank.tau.shape[0]):
            bank.score[b, i] = (bank.score[b, i] - most) * memory
    return found

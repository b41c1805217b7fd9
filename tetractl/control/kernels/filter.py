"""How the filters of `tetractl.control.filter` follow robots from frame to frame; the readable twin
is `tests/oracles/filter.py`."""

import math

import numpy as np

from tetractl.control.kernels import filter_state as at
from tetractl.control.kernels.filter_motion import advance, parameters_of, rate
from tetractl.control.kernels.filter_state import ASSUMED, MOVED, SIZE, SLOTS
from tetractl.core.kernels.kernel_cache import compiled
from tetractl.core.kernels.kernel_options import ENTRY_FAST, INLINE_FAST, inlined
from tetractl.model.motion import exact
from tetractl.model.motion.polynomials import wrap

_wrap, _rates = inlined(wrap), inlined(exact.rates)

# the states that each measured number depends on; the slopes by the last of x and y are 0
BY = np.array(
    [
        (at.X, at.HEADING, at.SINE, at.X, at.X),
        (at.Y, at.HEADING, at.SINE, at.Y, at.Y),
        (at.HEADING, at.MARKER, at.COSINE, at.LN_V, at.LN_W),
    ]
)


@compiled(**INLINE_FAST)
def _expected(model, i, z, slopes):
    """Return the pose that a camera would measure; its slopes by the states BY are filled."""
    c, s = math.cos(z[at.HEADING]), math.sin(z[at.HEADING])
    spin = model.helix * math.exp(z[at.LN_W]) / (parameters_of(model, i, z)[1] + 1e-300)
    across = spin * z[at.COSINE]
    flat = 1 / (1 + across * across)
    slopes[0, 0] = slopes[1, 0] = slopes[2, 0] = slopes[2, 1] = 1.0
    slopes[0, 1], slopes[1, 1] = -c * z[at.SINE], -s * z[at.SINE]
    slopes[0, 2], slopes[1, 2], slopes[2, 2] = -s, c, spin * flat
    slopes[2, 3], slopes[2, 4] = -across * flat, across * flat
    tilt = math.atan(across)
    return z[at.X] - s * z[at.SINE], z[at.Y] + c * z[at.SINE], z[at.HEADING] + z[at.MARKER] + tilt


@compiled(**INLINE_FAST)
def _correct(z, cov, j, slopes, off, var, gain):
    """Update by measured number j; return its variance before the update.

    The numbers differ by off (3,) from their predictions, which are updated too, and have
    variances var (3,). P is updated in Joseph's form, (1 - k h) P (1 - k h)' + k var k': after a
    long time without a fit, P is many orders larger than `var`, and by rounding P - k h P would
    not be a covariance.
    """
    total, miss = var[j], off[j]
    for k in range(SIZE):
        gain[k] = 0.0
        for n in range(len(BY[0])):
            gain[k] += slopes[j, n] * cov[BY[j, n], k]
    for n in range(len(BY[0])):
        total += slopes[j, n] * gain[BY[j, n]]
    for k in range(SIZE):
        share, left = gain[k] / total, 0.0
        z[k] += share * miss
        for m in range(SIZE):
            cov[k, m] -= share * gain[m]
        for n in range(len(BY[0])):
            left += cov[k, BY[j, n]] * slopes[j, n]
        for m in range(SIZE):
            cov[k, m] += (var[j] * share - left) * (gain[m] / total)
    for later in range(j + 1, 3):
        for n in range(len(BY[0])):
            off[later] -= slopes[later, n] * gain[BY[later, n]] * (miss / total)
    return total


@compiled(**INLINE_FAST)
def _measure(model, i, z, cov, scale, pose, found, work):
    """Update one hypothesis by a pose (3,); return the logarithm of the pose's likelihood.

    `found` (3,) is filled with the innovations along and across the course and of the heading, over
    their deviations; an outlier has the likelihood of a pose at the gate. `work` has scratch
    arrays.
    """
    _, slopes, off, var, gain = work
    expected = _expected(model, i, z, slopes)
    c, s = math.cos(z[at.HEADING]), math.sin(z[at.HEADING])
    d2 = lns = 0.0
    for j in range(3):
        off[j] = pose[j] - expected[j] if j < 2 else _wrap(pose[j] - expected[j])
        var[j] = sure = model.noise[j, i] ** 2 * scale[0 if j < 2 else 1]
        for n in range(len(BY[0])):
            for m in range(len(BY[0])):
                sure += slopes[j, n] * cov[BY[j, n], BY[j, m]] * slopes[j, m]
        d2 += off[j] * off[j] / sure
        lns += math.log(sure)
        found[j] = off[j] / math.sqrt(sure)
    found[0], found[1] = c * found[0] + s * found[1], c * found[1] - s * found[0]
    if not d2 <= ASSUMED.gate:
        return -0.5 * (ASSUMED.gate + lns)
    ln = 0.0
    for j in range(3):
        total = _correct(z, cov, j, slopes, off, var, gain)
        ln -= 0.5 * (off[j] * off[j] / total + math.log(total))
    for k in range(SIZE):
        for m in range(k):
            cov[k, m] = cov[m, k] = 0.5 * (cov[k, m] + cov[m, k])
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
    own, towards = parameters_of(model, i, z), u + z[at.BIAS]
    c, s = math.cos(z[at.HEADING]), math.sin(z[at.HEADING])
    a = rate(c, s, math.cos(towards), math.sin(towards), own, 0.0)[0]
    return 0.0 if math.isnan(u) else _rates(z[at.HEADING], towards, a, own[1])[2]


@compiled(**INLINE_FAST)
def likeliest(weight, count):
    """Return the index of the largest of the first `count` weights."""
    best = 0
    for s in range(1, count):
        best = s if weight[s] > weight[best] else best
    return best


@compiled(**INLINE_FAST)
def _blur(model, i, z, cov, before, u, step):
    """Add the uncertainty of the pose because the time at which u replaces `before` is uncertain by
    `step`, the spacing of the bank's dead times [s]."""
    changes = _rate(model, i, z, u) - _rate(model, i, z, before)
    cov[at.HEADING, at.HEADING] += (step * changes) ** 2 / 12
    if math.isnan(before) != math.isnan(u):
        speed = parameters_of(model, i, z)[1]
        cov[at.X, at.X] += (step * speed) ** 2 / 12
        cov[at.Y, at.Y] += (step * speed) ** 2 / 12


@compiled(**INLINE_FAST)
def _switch(bank, model, b, i, u, step, now):
    """Add the hypothesis that robot i, in its likeliest state, follows u [rad] from `now` [s]."""
    weight, held, until = bank.weight[b, i], bank.u[b, i], bank.until[b, i]
    follows = weight.size - 1
    best = place = likeliest(weight, follows)
    for s in range(follows):
        place = s if weight[s] < weight[place] else place
    heard = weight[best] + math.log(1 - ASSUMED.lost)
    for s in range(follows):
        if held[s] == u and weight[s] > -math.inf:  # the direction is the same as before
            if weight[s] < heard:
                _copy(bank, b, i, best, s)
                weight[s] = heard
            until[s] = now + model.watchdog
            return
    _copy(bank, b, i, best, place)
    for s in range(follows):
        weight[s] += math.log(ASSUMED.lost)
    z, cov = bank.state[b, i, place], bank.cov[b, i, place]
    before = held[best] if now < until[best] else math.nan
    _blur(model, i, z, cov, before, u, step)
    held[place], until[place], weight[place] = u, now + model.watchdog, heard


@compiled(**INLINE_FAST)
def _branch(bank, model, b, i, u, step, now):
    """Let robot i, in the state of each hypothesis, follow u [rad] from `now` [s], or not receive
    it, and keep the likeliest; two that follow one direction at like headings are one.
    """
    weight, held, until = bank.weight[b, i], bank.u[b, i], bank.until[b, i]
    follows = weight.size - 1
    state, cov = bank.state[b, i, :follows].copy(), bank.cov[b, i, :follows].copy()
    before, stops = held[:follows].copy(), until[:follows].copy()
    source, kept, ln = np.empty(follows, np.int64), 0, np.empty(2 * follows)
    for s in range(follows):
        same = before[s] == u
        ln[s] = weight[s] + (0.0 if same else math.log(1 - ASSUMED.lost))
        ln[follows + s] = -math.inf if same else weight[s] + math.log(ASSUMED.lost)
        weight[s] = -math.inf
    for _ in range(2 * follows):
        best = likeliest(ln, 2 * follows)
        s, chance, twin = best % follows, ln[best], -1
        way = u if best < follows else before[s]
        ln[best] = -math.inf
        for k in range(kept):
            gap = state[source[k], at.HEADING] - state[s, at.HEADING]
            like = gap**2 < ASSUMED.alike * cov[s, at.HEADING, at.HEADING]
            twin = k if twin < 0 and like and held[k] == way else twin
        if twin >= 0 and chance > -math.inf:
            weight[twin] += math.log(1 + math.exp(chance - weight[twin]))
        elif kept < follows and chance > -math.inf:
            z, p = bank.state[b, i, kept], bank.cov[b, i, kept]
            for k in range(z.size):  # arrays assigned whole take seconds to compile
                z[k] = state[s, k]
            for k in range(SIZE):
                for m in range(SIZE):
                    p[k, m] = cov[s, k, m]
            source[kept], weight[kept], held[kept], until[kept] = s, chance, way, stops[s]
            if best < follows:
                until[kept] = now + model.watchdog
                _blur(model, i, z, p, before[s] if now < stops[s] else math.nan, u, step)
            kept += 1


@compiled(**INLINE_FAST)
def _stick(bank, model, b, i, seconds, now):
    """Exchange probability between driving and being stuck, for the `seconds` before `now`, in
    which a stuck robot may have strayed."""
    weight = bank.weight[b, i]
    best, stuck = likeliest(weight, weight.size - 1), weight.size - 1
    if math.isnan(bank.u[b, i, best]) or bank.until[b, i, best] <= now:
        weight[stuck] = -math.inf
        return
    for k in range(at.HEADING + 1):
        rate = model.sticks.turns if k == at.HEADING else model.sticks.strays
        bank.cov[b, i, stuck, k, k] += rate * rate * seconds
    share = min(0.5, seconds / model.sticks.for_s)
    stays, free = weight[stuck] + math.log(1 - share), weight[stuck] + math.log(share)
    sticks = weight[best] + math.log(min(0.5, seconds / model.sticks.every_s))
    if free > weight[best]:
        _copy(bank, b, i, stuck, best)
        weight[best] = free
    elif sticks > stays:
        _copy(bank, b, i, best, stuck)
        stays = sticks
    weight[stuck] = stays


@compiled(**INLINE_FAST)
def _weigh(bank, b, i, model, pose, seconds, found, best, work):
    """Update all hypotheses of robot i by a pose; return the logarithm of the pose's likelihood."""
    weight, scale = bank.weight[b, i], bank.scale[b, i]
    most, total = -math.inf, 0.0
    for s in range(bank.weight.shape[2]):
        if weight[s] > -math.inf:
            z, cov = bank.state[b, i, s], bank.cov[b, i, s]
            weight[s] += _measure(model, i, z, cov, scale, pose, found, work)
            if weight[s] > most:
                most = weight[s]
                for k in range(3):
                    best[k] = found[k]
    for s in range(bank.weight.shape[2]):
        total += math.exp(weight[s] - most)
    total = most + math.log(total)
    for s in range(bank.weight.shape[2]):
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
            _place(bank, b, i, model, pose)
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


@compiled(**INLINE_FAST)
def _place(bank, b, i, model, pose):
    """Set the pose of every hypothesis of robot i to a measured pose (3,)."""
    bank.unfit[b, i] = 0.0
    for s in range(bank.weight.shape[2]):
        z, cov = bank.state[b, i, s], bank.cov[b, i, s]
        z[at.X], z[at.Y], z[at.HEADING] = pose[0], pose[1], pose[2] - z[at.MARKER]
        for j in (at.X, at.Y, at.HEADING):
            for k in range(SIZE):
                cov[j, k] = cov[k, j] = 0.0
            cov[j, j] = 4 * model.noise[j, i] ** 2


@compiled(**ENTRY_FAST)
def place(bank, model, when, u, time, poses, which):
    """Set the poses of the robots `which` (N,) to those of a frame, poses (N, 3), and let them
    follow the last of the commands u (C,), sent at `when` (C,) [s], that acts at the `time` (N,) of
    each robot's pose [s].
    """
    for i in range(which.size):
        for b in range(bank.tau.shape[0] if which[i] else 0):
            _place(bank, b, i, model, poses[i])
            acting = when.size
            while acting > 0 and when[acting - 1] > time[i] - bank.tau[b, i]:
                acting -= 1
            if acting > 0:
                bank.next[b, i] = acting
                for s in range(bank.weight.shape[2] - 1):  # a stuck robot follows none
                    bank.u[b, i, s] = u[acting - 1]
                    bank.until[b, i, s] = when[acting - 1] + model.watchdog + bank.tau[b, i]


@compiled(**INLINE_FAST)
def _equal(pose, other):
    """Return whether two poses (3,) are equal."""
    return pose[0] == other[0] and pose[1] == other[1] and pose[2] == other[2]


@compiled(**ENTRY_FAST)
def follow(bank, model, step, when, u, time, poses, seen, noisy):
    """Predict every filter from frame to frame, and update it by the poses of each frame.

    Commands u (C,) [rad], NaN for a stop, were sent at times when (C,) [s]. poses (F, N, 3) are
    measured at `time` (F, N) [s]; those with `seen` (F, N) True are used, from the second frame on,
    unless they are no newer than in the frame before. A frame all poses of which are those of the
    frame before is one that the camera has repeated, unless a stop acts by any dead time, and if
    measurements are `noisy`, so is each equal pose; those of a coarse camera are measurements.
    Returns ln of the likelihoods (B, N).
    """
    latest = 0.0
    for b in range(bank.tau.shape[0]):
        for i in range(bank.tau.shape[1]):
            latest = max(latest, bank.tau[b, i])
    found, off, best = np.zeros(bank.unfit.shape), np.zeros(3), np.zeros(3)
    work = np.empty((MOVED, SIZE)), np.zeros(BY.shape), np.empty(3), np.empty(3), np.empty(SIZE)
    for f in range(1, time.shape[0]):
        acting, first = when.size - 1, time[f - 1, 0]
        for i in range(1, len(model.parameters)):
            first = min(first, time[f - 1, i])
        while acting >= 0 and when[acting] > first - latest:
            acting -= 1
        # without noise, robots that are commanded to stand are seen at the same poses
        frozen = len(model.parameters) > 1 and not model.coarse
        frozen &= not (acting >= 0 and math.isnan(u[acting]))
        for i in range(len(model.parameters)):
            frozen &= _equal(poses[f, i], poses[f - 1, i])
        for i in range(len(model.parameters)):
            since, until = time[f - 1, i], time[f, i]
            if until <= since:
                continue
            repeated = frozen or (noisy and _equal(poses[f, i], poses[f - 1, i]))
            repeated &= not model.coarse
            used, most = seen[f, i] and not repeated, -math.inf
            for b in range(bank.tau.shape[0]):
                if bank.score[b, i] == -math.inf:
                    continue
                t, scale = since, bank.scale[b, i]
                while t < until:
                    coming, acts = bank.next[b, i], math.inf
                    if coming < when.size:
                        acts = when[coming] + bank.tau[b, i]
                    end = max(t, acts) if acts <= until else until  # `until` for NaN, too
                    for s in range(bank.weight.shape[2]):
                        if bank.weight[b, i, s] > -math.inf:
                            z, cov, held = bank.state[b, i, s], bank.cov[b, i, s], bank.u[b, i, s]
                            stops = min(max(bank.until[b, i, s], t), end)
                            for way, left in ((held, stops - t), (math.nan, end - stops)):
                                if left > 0:
                                    advance(model, i, z, cov, way, scale, left, work[0])
                    t = end
                    if acts <= until:
                        if bank.weight.shape[2] > SLOTS:
                            _branch(bank, model, b, i, u[coming], step, t)
                        else:
                            _switch(bank, model, b, i, u[coming], step, t)
                        bank.next[b, i] += 1
                if used:
                    pose, gap = poses[f, i], until - since
                    ln = _weigh(bank, b, i, model, pose, gap, off, best, work)
                    found[b, i] += ln
                    bank.score[b, i] += ln
                _stick(bank, model, b, i, until - since, until)
                most = max(most, bank.score[b, i])
            for b in range(bank.tau.shape[0]):
                forget = math.exp(-(until - since) / ASSUMED.forget_s)
                bank.score[b, i] = (bank.score[b, i] - most) * forget
    return found

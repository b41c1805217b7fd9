"""What a bank of filters (`tetractl.control.kernels.filter`) says as a whole: what its likeliest
hypotheses tell of robots, and which filters go on. The readable twin is `tests/oracles/bank.py`.
"""

import math

import numpy as np

from tetractl.control.kernels import filter_state as at
from tetractl.control.kernels.filter import likeliest
from tetractl.control.kernels.filter_motion import advance, parameters_of, rolled
from tetractl.control.kernels.filter_state import ASSUMED, GRID, MISFIT, SLOTS, STUCK
from tetractl.core.kernels.kernel_cache import compiled
from tetractl.core.kernels.kernel_options import ENTRY_FAST, INLINE_FAST


@compiled(**ENTRY_FAST)
def forecast(bank, model, shared, when, u, begin, sent, found):
    """Fill found (FOUND, N) with what each robot's likeliest hypothesis tells; return the mean of
    the dead times and its standard deviation [s].

    Poses are those at which a command sent at `sent` [s] acts on each robot, and those in which
    lagging wheels come to rest if they then stop; they are predicted from each robot's `begin` (N,)
    [s] through commands u (C,) [rad], sent at times when (C,) [s]. Standard deviations grow by what
    the test of the innovations finds.
    """
    count, z = len(model.parameters), np.empty(bank.state.shape[3])
    mean = doubt = 0.0
    for i in range(count):
        best = likeliest(shared.score[:, i], bank.tau.shape[0])
        slot, every = likeliest(bank.weight[best, i], SLOTS), 0.0
        for s in range(SLOTS):
            every += math.exp(bank.weight[best, i, s] - bank.weight[best, i, slot])
        stuck = math.exp(bank.weight[best, i, STUCK] - bank.weight[best, i, slot])
        found[at.STANDS, i] = stuck / every
        for k in range(z.size):
            z[k] = bank.state[best, i, slot, k]
        cov, white, more = bank.cov[best, i, slot], bank.white[best, i, 1], 1.0
        blocks = max(white[3], ASSUMED.least_blocks)
        part = 2 / (9 * blocks)
        limit = blocks * (1 - part + ASSUMED.sure * math.sqrt(part)) ** 3
        for k in range(3):
            more = max(more, white[k] / blocks)
            found[MISFIT.start + k, i] = white[k] / limit
        more = math.sqrt(more)
        tau, deviation = shared.dead_times[0, i], more * shared.dead_times[1, i]
        mean, doubt = mean + tau, doubt + deviation * deviation
        a, speed, side, saturation = parameters_of(model, i, z)
        found[3, i], found[4, i] = a, more * a * math.sqrt(max(cov[at.LN_A, at.LN_A], 0.0))
        found[5, i], found[6, i] = speed, more * speed * math.sqrt(max(cov[at.LN_V, at.LN_V], 0.0))
        var = cov[at.BIAS, at.BIAS] + cov[at.MARKER, at.MARKER] + 2 * cov[at.BIAS, at.MARKER]
        found[7, i], found[8, i] = z[at.BIAS] + z[at.MARKER], more * math.sqrt(max(var, 0.0))
        found[9, i] = z[at.BIAS]
        found[10, i] = _ahead(bank, model, best, i, slot, when, u, tau, begin[i], sent, z)
        found[11, i], found[12, i] = z[at.FLOW_X], z[at.FLOW_Y]
        found[16, i], found[18, i] = side, saturation
        found[17, i] = more * math.sqrt(max(cov[at.SIDE, at.SIDE], 0.0))
        for k in range(3):
            found[k, i] = z[k]
    mean /= count
    for i in range(count):
        doubt += (shared.dead_times[0, i] - mean) ** 2
    return mean, math.sqrt(doubt / count)


@compiled(**INLINE_FAST)
def _ahead(bank, model, b, i, s, when, u, tau, begin, sent, z):
    """Predict the state z of a hypothesis of robot i to the moment when a command acts, tau [s]
    after it is sent; return the direction followed then [rad], NaN for a robot that stands."""
    now, stops = bank.u[b, i, s], bank.until[b, i, s]
    t, until = begin, max(sent + tau, begin)
    held = now if stops > until else math.nan
    for c in range(when.size + 1):
        acts = when[c] + tau if c < when.size else until
        end = min(max(acts, t), until)
        drives = min(max(stops, t), end) - t
        for way, seconds in ((now, drives), (math.nan, end - t - drives)):
            if seconds > 0:
                advance(model, i, z, None, way, None, seconds, None)
        t = end
        if c < when.size and acts > begin and s != STUCK:
            now, stops = u[c], acts + model.watchdog
            if acts <= until + 1e-9:
                held = now if stops > until else math.nan
    a, speed, _, _ = parameters_of(model, i, z)
    turn, way = model.lag * a * z[at.SWING], model.lag * speed * z[at.PACE]
    east, north = rolled(z[at.HEADING], turn, way)
    z[at.X], z[at.Y], z[at.HEADING] = z[at.X] + east, z[at.Y] + north, z[at.HEADING] + turn
    return held


@compiled(**INLINE_FAST)
def _share(bank, shared, steps):
    """Compute ln of each filter's probability, by its own frames and by what those of the other
    robots tell of the common dead time, and each robot's dead time.

    A filter's frames tell of a time by `near`; those of the others by their sums over filters.
    """
    near, room, score = shared.near, shared.room, shared.score
    own = np.empty(score.shape[0])
    for i in range(steps.size):
        for b in range(own.size):
            own[b] = math.exp(bank.score[b, i])
        for t in range(room.shape[0]):
            total = 0.0
            for b in range(own.size):
                total += near[t, b, i] * own[b]
            room[t, i] = math.log(total + 1e-300)
    for t in range(room.shape[0]):
        every = shared.prior[t]
        for i in range(steps.size):
            every += room[t, i]
        for i in range(steps.size):
            room[t, i] = every - room[t, i]
    for i in range(steps.size):
        most, total, mean, spread = -math.inf, 0.0, 0.0, 0.0
        for t in range(room.shape[0]):
            most = max(most, room[t, i])
        for b in range(own.size):
            own[b] = 0.0
        for t in range(room.shape[0]):
            others = math.exp(room[t, i] - most)
            for b in range(own.size):
                own[b] += near[t, b, i] * others
        most = -math.inf
        for b in range(own.size):
            score[b, i] = bank.score[b, i] + math.log(own[b] + 1e-300)
            most = max(most, score[b, i])
        for b in range(own.size):
            own[b] = math.exp(score[b, i] - most)
            total += own[b]
            mean += own[b] * bank.tau[b, i]
        mean /= total
        for b in range(own.size):
            spread += own[b] / total * (bank.tau[b, i] - mean) ** 2
        shared.dead_times[0, i] = mean
        shared.dead_times[1, i] = math.sqrt(spread + (steps[i] / 4) ** 2)


@compiled(**ENTRY_FAST)
def select(bank, shared, steps, begun, changes, which, tau, own):
    """Compute the probabilities of filters, and select each robot's if the bank may have `changes`:
    its grid of dead times is refined around likely ones.

    steps (N,) [s] are the spacings of the grids, halved in place. Filters far less likely than the
    best are dropped, and of two frequencies of the helix that have become the same the less likely.
    A grid changes only if commands were sent (`begun`). which (C, N) are filled with the filters
    that go on, -1 after the last one, tau and own (C, N) with their dead times [s] and own ln
    likelihoods. Returns whether anything has changed.
    """
    _share(bank, shared, steps)
    if not changes:
        return False
    changed, score, kept = False, shared.score, np.empty(which.shape[0], np.int64)
    for i in range(steps.size):
        for b in range(which.shape[0]):
            which[b, i] = -1
        count, best = 0, 0
        while count < score.shape[0] and bank.score[count, i] > -math.inf:
            best = count if score[count, i] > score[best, i] else best
            count += 1
        least, n, ends = score[best, i] - GRID.unlikely, 0, 0
        while ends < count:  # filters of one frequency follow each other, in the order of times
            begins = top = ends
            first = last = -1
            while ends < count and bank.pitch[ends, i] == bank.pitch[begins, i]:
                top = ends if score[ends, i] > score[top, i] else top
                if score[ends, i] >= least:
                    first, last = ends if first < 0 else first, ends
                ends += 1
            same = abs(_reached(bank, top, i) - _reached(bank, best, i)) < GRID.same_pitch
            if first >= 0 and (bank.pitch[top, i] == bank.pitch[best, i] or not same):
                for b in range(max(begins, min(first, top - 1)), min(ends, max(last, top + 1) + 1)):
                    kept[n], n = b, n + 1
        middle, below, above, m = bank.tau[best, i], False, False, n  # m dead times
        for r in range(n):
            b = kept[r]
            which[r, i], tau[r, i], own[r, i] = b, bank.tau[b, i], bank.score[b, i]
            below, above = below or tau[r, i] < middle, above or tau[r, i] > middle
            for q in range(r):
                if tau[q, i] == tau[r, i]:
                    m -= 1
                    break
        changed |= n < count
        if m > 3 or not begun:
            continue
        if steps[i] > GRID.finest_s and m == 3:
            steps[i] /= 2
        elif above and (below or middle == 0):
            continue
        changed, group, n = True, kept[:n], 0
        for p in range(bank.pitch[count - 1, i] + 1):
            for k in range(-1, 2):  # frequencies that the poses do not distinguish stay
                time = max(middle + steps[i] * k, 0.0)
                near, ln = _between(bank, group, p, i, time)
                if near >= 0 and (k != 0 or middle > 0):
                    which[n, i], tau[n, i], own[n, i] = near, time, ln
                    n += 1
        for b in range(n, which.shape[0]):
            which[b, i] = -1
    return changed


@compiled(**INLINE_FAST)
def _reached(bank, b, i):
    """Return ln of the frequency of the helix that a filter of robot i has reached."""
    return bank.state[b, i, likeliest(bank.weight[b, i], SLOTS), at.LN_W]


@compiled(**INLINE_FAST)
def _between(bank, group, p, i, time):
    """Return which of a group of filters with helix p has its dead time nearest to `time` [s], -1
    for none, and the ln likelihood of `time`, between those of two filters."""
    near, before, ln, above = -1, -1, 0.0, False
    for b in group:
        if bank.pitch[b, i] == p and not above:
            high, own = bank.tau[b, i], bank.score[b, i]
            if near < 0 or abs(high - time) < abs(bank.tau[near, i] - time):
                near = b
            above = time < high
            if above and before >= 0:
                low, rise = bank.tau[before, i], own - bank.score[before, i]
                ln = bank.score[before, i] + (time - low) / (high - low) * rise
            else:
                ln = own
            before = b
    return near, ln

"""What a bank of filters (`tetractl.control.kernels.filter`) says as a whole: where its likeliest
hypotheses lead, and which filters are to go on.
"""

import math

import numpy as np

from tetractl.control.kernels.cache import compiled
from tetractl.control.kernels.filter import advance
from tetractl.control.kernels.filter_state import (
    GRID,
    HEADING,
    LN_A,
    LN_V,
    LN_W,
    PACE,
    STUCK,
    SWING,
    X,
    Y,
)
from tetractl.control.kernels.options import ENTRY_FAST, INLINE_FAST


@compiled(**ENTRY_FAST)
def ahead(bank, model, best, slot, when, u, tau, begin, sent, states, held):
    """Predict each robot by the hypothesis slot (N,) of its filter best (N,) from `begin` [s] to
    the moment when a command sent at `sent` [s] acts on it, tau (N,) [s] later.

    Commands u (C,) [rad] were sent at times when (C,) [s]. states (N, STATE) are filled, as are the
    directions held (N,) [rad] that robots follow then, NaN for a robot that stands. Lagging wheels
    then stop: the states are those in which the robots come to rest.
    """
    for i in range(tau.size):
        b, s, z = best[i], slot[i], states[i]
        for k in range(z.size):
            z[k] = bank.state[b, i, s, k]
        now, stops = bank.u[b, i, s], bank.until[b, i, s]
        t, until = begin, max(sent + tau[i], begin)
        held[i] = now if stops > until else math.nan
        for c in range(when.size + 1):
            acts = when[c] + tau[i] if c < when.size else until
            end = min(max(acts, t), until)
            drives = min(max(stops, t), end) - t
            for way, seconds in ((now, drives), (math.nan, end - t - drives)):
                if seconds > 0:
                    advance(model, i, z, None, way, None, seconds, None)
            t = end
            if c < when.size and acts > begin and s != STUCK:
                now, stops = u[c], acts + model.watchdog
                if acts <= until + 1e-9:
                    held[i] = now if stops > until else math.nan
        turn = model.lag * model.a[i] * math.exp(z[LN_A]) * z[SWING]
        half = 0.5 * turn
        chord = model.lag * model.speed[i] * math.exp(z[LN_V]) * z[PACE] * (1 - half * half / 6)
        z[X] += chord * math.cos(z[HEADING] + half)
        z[Y] += chord * math.sin(z[HEADING] + half)
        z[HEADING] += turn


@compiled(**ENTRY_FAST)
def select(bank, score, steps, begun, which, tau, own):
    """Select each robot's filters, and refine its grid of dead times around likely ones.

    score (B, N) are the shared ln probabilities of all robots' filters; steps (N,) [s] the spacings
    of the grids, halved in place. Filters far less likely than the best are dropped, and of two
    frequencies of the helix that have become the same the less likely. A grid changes only if
    commands were sent (`begun`). which (C, N) are filled with the filters that go on, -1 after the
    last one, tau and own (C, N) with their dead times [s] and own ln likelihoods. Returns whether
    anything has changed.
    """
    changed, size = False, score.shape[0]
    keep, grid, new = np.empty(size, np.bool_), np.empty(size + 1), np.empty(3)
    for i in range(steps.size):
        for b in range(which.shape[0]):
            which[b, i] = -1
        count, best = 0, 0
        while count < size and bank.score[count, i] > -math.inf:
            best = count if score[count, i] > score[best, i] else best
            count += 1
        least, pitches = score[best, i] - GRID.unlikely, 0
        for b in range(count):
            keep[b] = False
            pitches = max(pitches, bank.pitch[b, i] + 1)
        for p in range(pitches):
            top, first, last, begins, ends = -1, -1, -1, -1, -1
            for b in range(count):
                if bank.pitch[b, i] == p:
                    begins, ends = b if begins < 0 else begins, b
                    if top < 0 or score[b, i] > score[top, i]:
                        top = b
                    if score[b, i] >= least:
                        first, last = b if first < 0 else first, b
            same = abs(_reached(bank, max(top, 0), i) - _reached(bank, best, i)) < GRID.same_pitch
            if first < 0 or (p != bank.pitch[best, i] and same):
                continue
            for b in range(max(begins, min(first, top - 1)), min(ends, max(last, top + 1)) + 1):
                keep[b] = True
        n = m = 0  # numbers of filters kept, and of their dead times
        for b in range(count):
            if keep[b]:
                which[n, i], tau[n, i], own[n, i] = b, bank.tau[b, i], bank.score[b, i]
                n, place = n + 1, 0
                while place < m and grid[place] < bank.tau[b, i]:
                    place += 1
                if place == m or grid[place] != bank.tau[b, i]:
                    for k in range(m, place, -1):
                        grid[k] = grid[k - 1]
                    grid[place], m = bank.tau[b, i], m + 1
        changed |= n < count
        if m > 3 or not begun:
            continue
        at = 0
        while grid[at] < bank.tau[best, i]:
            at += 1
        if steps[i] > GRID.finest_s and m == 3:
            steps[i] /= 2
        elif 0 < at < m - 1 or (at == 0 and grid[0] == 0 and m > 1):
            continue
        fresh = 0
        for k in range(-1, 2):
            new[fresh] = max(grid[at] + steps[i] * k, 0.0)
            if fresh == 0 or new[fresh] != new[fresh - 1]:
                fresh += 1
        changed, kept, n = True, which[:n, i].copy(), 0
        for p in range(pitches):  # frequencies that the poses do not distinguish stay
            group = kept[bank.pitch[kept, i] == p]
            for time in new[: fresh if group.size else 0]:
                near = group[0]
                for b in group:
                    if abs(bank.tau[b, i] - time) < abs(bank.tau[near, i] - time):
                        near = b
                which[n, i], tau[n, i] = near, time
                own[n, i] = _interpolated(bank, group, i, time)
                n += 1
        for b in range(n, which.shape[0]):
            which[b, i] = -1
    return changed


@compiled(**INLINE_FAST)
def _reached(bank, b, i):
    """Return ln of the frequency of the helix that a filter of robot i has reached."""
    return bank.state[b, i, np.argmax(bank.weight[b, i]), LN_W]


@compiled(**INLINE_FAST)
def _interpolated(bank, group, i, time):
    """Return the ln likelihood of a dead time `time` [s], between those of a group of filters."""
    before = group[0]
    for b in group:
        low, high = bank.tau[before, i], bank.tau[b, i]
        if time < high:
            rise = bank.score[b, i] - bank.score[before, i]
            share = (time - low) / (high - low) if high > low else 0.0
            return bank.score[before, i] + share * rise
        if time == high:
            return bank.score[b, i]
        before = b
    return bank.score[before, i]

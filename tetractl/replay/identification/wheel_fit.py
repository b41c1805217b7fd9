"""The distance from a wheel to a robot's centre, from the wheel speeds sent and the turns seen.

By (23) a robot turns by 1/r times the integral of (right - left)/2, of the wheel speeds that it
has: those sent, a dead time later and behind a lag of first order, both shared by all robots and
found by least squares on a grid. Where robots turn to the direction by themselves the direction
explains the turns better than the wheel speeds do, and no distance is given.
"""

import numpy as np

from tetractl.core.poses import Bools, Floats, wrap
from tetractl.replay.identification.chain import Chain, ChainNoise, SampleInterval
from tetractl.replay.identification.fit import Fitted
from tetractl.replay.identification.tracks import Directions, Drives, pieces

STEP_S, LATEST_S = 0.004, 0.3  # of the dead times tried
LAG_STEP_S, LAG_MAX_S = 0.01, 0.1  # and of the lags
TAIL = 4.0  # lags after which nothing is left of a wheel speed
OUTLYING = 4.0  # deviations
ROUNDS = 3
WORSE = 1.5  # times as far off as the direction's model, at most


def track_radii(drives: Drives, fitted: Fitted) -> list[SampleInterval | None]:
    """Return r of each robot [length unit], None where wheel speeds do not explain its turns."""
    known: Bools = ~np.isnan(drives.left.sum(axis=0) + drives.right.sum(axis=0))
    count = known.size
    if not known.any():
        return [None] * count
    turned, usable = drives.intervals.turned, drives.intervals.usable
    prompt = _driven(drives, np.arange(0.0, LATEST_S + TAIL * LAG_MAX_S, STEP_S))
    lags = np.arange(0.0, LAG_MAX_S + 1e-9, LAG_STEP_S)
    late = round(LATEST_S / STEP_S)
    lagged = np.array([_lagged(prompt, lag)[:late] for lag in lags])  # (L, T, K, N)
    misfits = [[_misfit(turned, one, usable, known) for one in row] for row in lagged]
    lag, tau = np.unravel_index(int(np.argmin(misfits)), np.shape(misfits))
    driven = lagged[lag, tau]
    by_tau, by_lag = (
        (more - less) / step
        for more, less, step in (
            (
                lagged[lag, min(tau + 1, lagged.shape[1] - 1)],
                lagged[lag, max(tau - 1, 0)],
                STEP_S * (min(tau + 1, lagged.shape[1] - 1) - max(tau - 1, 0)),
            ),
            (
                lagged[min(lag + 1, len(lags) - 1), tau],
                lagged[max(lag - 1, 0), tau],
                LAG_STEP_S * (min(lag + 1, len(lags) - 1) - max(lag - 1, 0)),
            ),
        )
    )
    by_direction = np.abs(fitted.turns.missed(fitted.best))
    found: list[SampleInterval | None] = []
    for i in range(count):
        interval = None
        if known[i] and _rate(turned[:, i], driven[:, i], usable[:, i]) > 0:
            columns = np.column_stack([driven[:, i], by_tau[:, i], by_lag[:, i]])
            interval, off = _radius(drives, i, columns)
            if off > WORSE * float(np.median(by_direction[usable[:, i], i])):
                interval = None
        found.append(interval)
    return found


def _driven(drives: Drives, dead_times: Floats) -> Floats:
    """Return the integrals of (right - left)/2 over the intervals, (T, K, N) [length unit]."""
    half = np.nan_to_num((drives.right - drives.left) / 2)
    numbers = Directions(drives.wheels_when, np.arange(len(half), dtype=np.float64))
    total = np.zeros((len(dead_times), *drives.intervals.heading.shape))
    for number, seconds in pieces(drives.intervals, numbers, dead_times):
        total += half[number.astype(np.int64)] * seconds[..., None]
    return total


def _lagged(prompt: Floats, lag: float) -> Floats:
    """Return the integrals (T, K, N) behind a lag [s]: a mean over later dead times."""
    if lag == 0:
        return prompt
    behind = np.arange(round(TAIL * LAG_MAX_S / STEP_S))
    weights = np.exp(-behind * STEP_S / lag)
    total = np.zeros_like(prompt[: len(prompt) - len(behind)])
    for shift, weight in zip(behind, weights / weights.sum(), strict=True):
        if weight > 1e-4:
            total += weight * prompt[shift : shift + len(total)]
    return total


def _rate(turned: Floats, driven: Floats, usable: Bools) -> float:
    """Return the least-squares 1/r of one robot."""
    one = driven[usable]
    return float(one @ turned[usable] / (one @ one + 1e-300))


def _misfit(turned: Floats, driven: Floats, usable: Bools, known: Bools) -> float:
    """Return how far the wheel speeds miss the turns of all robots, little moved by outliers."""
    total = 0.0
    for i in np.flatnonzero(known):
        rate = _rate(turned[:, i], driven[:, i], usable[:, i])
        missed = wrap(turned[:, i] - rate * driven[:, i])[usable[:, i]]
        total += float(np.minimum(np.abs(missed), 0.2).mean())
    return total


def _radius(drives: Drives, robot: int, columns: Floats) -> tuple[SampleInterval, float]:
    """Return r of a robot, and the median of what its turns miss the wheel speeds' by [rad].

    `columns` (K, 3) are the integrals, and their derivatives by the dead time and by the lag, which
    are fitted with it.
    """
    turned, usable = drives.intervals.turned[:, robot], drives.intervals.usable[:, robot]
    weak = np.diag([0.0, (2 * STEP_S) ** -2.0, LAG_STEP_S**-2.0])
    rate, shifts = _rate(turned, columns[:, 0], usable), np.zeros(2)
    deviation, std, r = np.full(len(turned), np.inf), np.inf, turned
    for _ in range(ROUNDS):
        driven = columns[:, 0] + columns[:, 1:] @ shifts
        r = wrap(turned - rate * driven)
        if not np.isfinite(deviation).all():
            deviation = np.full(len(turned), float(np.median(np.abs(r[usable]))) / 0.6745)
        used = usable & (np.abs(r) <= OUTLYING * deviation + 1e-9)
        chain = Chain(drives.seconds, np.ones_like(r), used, drives.after)
        noise: ChainNoise = chain.noise_of(r, driven[:, None])
        deviation = np.sqrt(2 * noise.measured**2 + noise.walk**2 * drives.seconds)
        y, *by = chain.whiten(
            chain.factor(noise), np.column_stack([r, driven, rate * columns[:, 1:]])
        ).T
        matrix = np.column_stack(by)
        normal = matrix.T @ matrix + weak
        change = np.linalg.solve(normal, matrix.T @ y - weak @ np.append(0.0, shifts))
        rate, shifts = rate + float(change[0]), shifts + change[1:]
        std = float(np.sqrt(np.linalg.inv(normal)[0, 0]))
    low, high = rate + 1.96 * std, rate - 1.96 * std
    interval = SampleInterval(1 / rate, 1 / low, 1 / high if high > 0 else np.inf)
    return interval, float(np.median(np.abs(r[usable])))

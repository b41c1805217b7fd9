"""What samplers search in: the coordinates of a sequence of signals, all of them angles.

A direction is its own coordinate. An intensity from low to high is the angle w,

    intensity = low + (high - low) |w| / pi,   -pi <= w <= pi,

so that an intensity beyond a bound turns back, as a direction beyond pi goes on at -pi, and
samplers need no other rule for it. The coordinates of L signals are L directions and, if a problem
has an intensity, L angles w.
"""

from dataclasses import replace

import numpy as np

from tetractl.core.plan import Problem, Search
from tetractl.core.poses import Floats


def coordinates(problem: Problem, length: int) -> int:
    """Return the number of coordinates of `length` signals."""
    return length if problem.intensity is None else 2 * length


def encoded(problem: Problem, signals: Floats) -> Floats:
    """Return the coordinates (C,) of signals (L,), or (L, 2); the intensity may be out of bounds,
    as that of a signal 0 is."""
    if (of := problem.intensity) is None:
        return signals
    share = (np.clip(signals[:, 1], of.low, of.high) - of.low) / (of.high - of.low)
    return np.concatenate([signals[:, 0], np.pi * share])


def intensities(problem: Problem, found: Floats) -> Floats:
    """Return the intensities (L, P) of sequences by their coordinates (2 L, P)."""
    of = problem.intensity
    assert of is not None
    return of.low + (of.high - of.low) * np.minimum(np.abs(found[len(found) // 2 :]) / np.pi, 1.0)


def decoded(problem: Problem, search: Search) -> Search:
    """Return a search with its signals (L,), or (L, 2), in place of their coordinates."""
    if problem.intensity is None:
        return search
    found = search.signals[: search.length], intensities(problem, search.signals)
    return replace(search, signals=np.stack(found, axis=-1))

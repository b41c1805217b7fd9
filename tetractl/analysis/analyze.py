"""Predicts how the total error of an experiment depends on the robots' turning rates a and on their
number, and proposes changes."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from tetractl.analysis.closed_loop import Noise, left_out
from tetractl.analysis.reach import Reach, reach
from tetractl.analysis.steering import Steering, planner, steering, tolerance
from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.experiment.experiment import Experiment

GAPS = (0.02, 0.05, 0.1, 0.2, 0.35, 0.5)
"""Errors are predicted for turning rates that each exceed the next lower one by these fractions."""
TOO_ALIKE = 0.2
"""If two robots' turning rates differ by less than this fraction, other rates are tried."""
STEPS = (0.1, 0.15, 0.2, 0.3, 0.4, 0.5)
"""Relative differences of turning rate that are tried for the two robots most alike in it."""
WORTH = 0.8
"""An advised change must reduce the predicted error to at most this fraction of its value."""
AS_GOOD = 1.1
"""Of the changes with at most this factor times the least error, the smallest is advised."""


@dataclass(frozen=True, slots=True)
class Change:
    """A proposed turning rate a [rad/s] of a robot, and the mean total error predicted with it."""

    robot: str
    old: float
    new: float
    error: float


@dataclass(frozen=True, slots=True)
class Analysis:
    """The analysis of an experiment's N robots; errors are predicted mean total errors.

    `reach` is what the signal can reach, None for very many robots.
    `plans` is the number of plans searched, `steering` the analysis of those that reach the
    targets, with a cost of at most `tolerance` [length unit], None if none does. An error is NaN if
    no plan was found. `left_out` lists disturbances of the plant that are not in the predictions.
    `alike` are the two robots whose turning rates a differ least, `gap` is their difference
    relative to the smaller rate; for one robot `alike` is None and `gap` inf. `by_gap` pairs
    relative differences with errors: the turning rates keep their order and geometric mean, and
    each exceeds the next lower rate by this relative difference. `by_count` pairs a number n with
    the error of the spec's first n robots. `change` is the advised change if two robots are too
    alike and another turning rate reduces the error; `looked` is whether changes were tried.
    """

    setup: Setup
    reach: Reach | None
    noise: Noise
    left_out: tuple[str, ...]
    tolerance: float
    plans: int
    steering: Steering | None
    alike: tuple[str, str] | None
    gap: float
    by_gap: tuple[tuple[float, float], ...]
    by_count: tuple[tuple[int, float], ...]
    looked: bool
    change: Change | None


def analyze(
    experiment: Experiment, plans: int, on_done: Callable[[int, int], object] = lambda *_: None
) -> Analysis:
    """Analyse an experiment's robots, and variants of them, each along a number of plans; `on_done`
    is called with the number of analyses done and the number of all."""
    setup, noise = experiment.setup, Noise.of(experiment.plant)
    section, seed = planner(experiment), experiment.trials.seed
    gap, alike = smallest_gap(setup)
    candidates = list(_candidates(setup, alike)) if alike and gap < TOO_ALIKE else []
    several = len(setup.names) > 1
    count = 1 + (len(GAPS) + len(setup.names) - 1 if several else 0) + len(candidates)
    done = 0

    def found(of: Setup) -> Steering | None:
        nonlocal done
        result = steering(section, of, noise, seed, plans)
        done += 1
        on_done(done, count)
        return result

    def error(of: Setup) -> float:
        result = found(of)
        return math.nan if result is None else result.error

    here = found(setup)
    now = math.nan if here is None else here.error
    numbers = range(1, len(setup.names)) if several else ()
    by_count = [(n, error(setup.only(range(n)))) for n in numbers]
    by_gap = [(one, error(respaced(setup, one))) for one in GAPS] if several else []
    changes = [
        Change(setup.names[i], float(setup.a[i]), a, error(replace(setup, a=_with(setup.a, i, a))))
        for i, a in candidates
    ]
    return Analysis(
        setup=setup,
        reach=reach(experiment),
        noise=noise,
        left_out=left_out(experiment.plant),
        tolerance=tolerance(section),
        plans=plans,
        steering=here,
        alike=None if alike is None else (setup.names[alike[0]], setup.names[alike[1]]),
        gap=gap,
        by_gap=tuple(by_gap),
        by_count=(*by_count, (len(setup.names), now)),
        looked=bool(candidates),
        change=best_change(changes, now),
    )


def smallest_gap(setup: Setup) -> tuple[float, tuple[int, int] | None]:
    """Return the least relative difference between the turning rates a of two robots, and the
    indices of the two, the one with the smaller rate first.
    """
    order = np.argsort(setup.a, kind="stable")
    if len(order) < 2:
        return float("inf"), None
    gaps = setup.a[order[1:]] / setup.a[order[:-1]] - 1
    at = int(np.argmin(gaps))
    return float(gaps[at]), (int(order[at]), int(order[at + 1]))


def respaced(setup: Setup, gap: float) -> Setup:
    """Return the setup with other turning rates a: each is 1 + `gap` times the next lower one, and
    their geometric mean is unchanged."""
    rank = np.argsort(np.argsort(setup.a, kind="stable"))
    middle = np.exp(np.log(setup.a).mean())
    return replace(setup, a=middle * (1 + gap) ** (rank - (len(rank) - 1) / 2))


def best_change(changes: list[Change], error: float) -> Change | None:
    """Return the smallest change whose error is at most `AS_GOOD` times the least, None if no
    change helps.

    `error` is the error without a change; an error is NaN if no plan was found.
    """
    most = math.inf if math.isnan(error) else WORTH * error
    least = min((one.error for one in changes if one.error <= most), default=None)
    if least is None:
        return None
    good = [one for one in changes if one.error <= min(AS_GOOD * least, most)]
    return min(good, key=lambda one: abs(np.log(one.new / one.old)))


def _candidates(setup: Setup, alike: tuple[int, int]) -> Iterator[tuple[int, float]]:
    """Yield (index, new turning rate) of one of the robots `alike`: rates that raise the least
    gap."""
    low, high = alike
    old, _ = smallest_gap(setup)
    for step in STEPS:
        for i, a in ((high, setup.a[low] * (1 + step)), (low, setup.a[high] / (1 + step))):
            new = float(f"{a:.3g}")
            if smallest_gap(replace(setup, a=_with(setup.a, i, new)))[0] > max(old, 0.5 * step):
                yield i, new


def _with(values: Floats, i: int, value: float) -> Floats:
    changed = values.copy()
    changed[i] = value
    return changed

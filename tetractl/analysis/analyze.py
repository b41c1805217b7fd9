"""Predicts how the total error of an experiment depends on the robots' turning rates a and on their
number, and proposes changes.

The error of a setup is the mean total error that `tetractl.analysis.steering` predicts [length
unit], the median over its plans. It is predicted for

    the robots as they are
    the first n of them              for each lower n
    robots of other turning rates    each exceeds the next lower one by a fraction of GAPS, the
                                     *gap*; their geometric mean is unchanged
    one robot changed                if the two most alike differ in a by less than TOO_ALIKE: one
                                     of these two gets another a, so that they differ by a fraction
                                     of STEPS

Of the changes that lower the error enough, the smallest of those about as good as the best is
advised (`best_change`).
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from tetractl.analysis.closed_loop import Noise, left_out
from tetractl.analysis.reach import Reach, reach
from tetractl.analysis.steering import Steering, planner, steering, tolerance
from tetractl.core.setup import Setup
from tetractl.experiment.experiment import Experiment

GAPS = (0.02, 0.05, 0.1, 0.2, 0.35, 0.5)
"""Errors are predicted for turning rates that each exceed the next lower one by these fractions."""
TOO_ALIKE = 0.2
"""If two robots' turning rates differ by less than this fraction, other rates are tried."""
STEPS = (0.1, 0.15, 0.2, 0.3, 0.4, 0.5)
"""Relative differences of turning rate that are tried for the two robots most alike in it."""
GAP_OF_STEP = 0.5
"""A change is tried only if no two robots differ in a by less than this fraction of its step: it
would make one of the two like a third robot."""
WORTH = 0.8
"""An advised change must reduce the predicted error to at most this fraction of its value."""
AS_GOOD = 1.1
"""Of the changes with at most this factor times the least error, the smallest is advised."""


@dataclass(frozen=True, slots=True)
class Change:
    """A proposed turning rate [rad/s] of a robot, `a_advised` in place of `a`, and the mean total
    error predicted with it."""

    robot: str
    a: float
    a_advised: float
    mean_total_error: float


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
    setup = experiment.setup
    several = len(setup.names) > 1
    fewer = range(1, len(setup.names))
    gaps = GAPS if several else ()
    alike = most_alike(setup)
    tried: list[tuple[int, float]] = []
    least_gap = math.inf if alike is None else _gap(setup, *alike)
    if alike is not None and least_gap < TOO_ALIKE:
        tried = list(_rates_to_try(setup, *alike))

    count = 1 + len(fewer) + len(gaps) + len(tried)
    predictor = _Predictor(experiment, plans, lambda done: on_done(done, count))
    as_they_are = predictor.steering(setup)
    error = _error(as_they_are)
    by_count = [(n, predictor.error(setup.only(range(n)))) for n in fewer]
    by_gap = [(gap, predictor.error(respaced(setup, gap))) for gap in gaps]
    changes: list[Change] = []
    for robot, a in tried:
        changed_error = predictor.error(_with_rate(setup, robot, a))
        changes.append(Change(setup.names[robot], float(setup.a[robot]), a, changed_error))

    return Analysis(
        setup=setup,
        reach=reach(experiment),
        noise=predictor.noise,
        left_out=left_out(experiment.plant),
        tolerance=tolerance(predictor.section),
        plans=plans,
        steering=as_they_are,
        alike=None if alike is None else (setup.names[alike[0]], setup.names[alike[1]]),
        gap=least_gap,
        by_gap=tuple(by_gap),
        by_count=(*by_count, (len(setup.names), error)),
        looked=bool(tried),
        change=best_change(changes, error),
    )


class _Predictor:
    """Predicts the errors of setups as steered in one experiment, along a number of plans each;
    `on_done` is called with the number of predictions so far."""

    def __init__(
        self, experiment: Experiment, plans: int, on_done: Callable[[int], object]
    ) -> None:
        self.section = planner(experiment)
        self.noise = Noise.of(experiment.plant)
        self._seed = experiment.trials.seed
        self._plans = plans
        self._on_done = on_done
        self._done = 0

    def steering(self, setup: Setup) -> Steering | None:
        """Analyse the plans of a setup; None if none reaches the targets."""
        analysed = steering(self.section, setup, self.noise, self._seed, self._plans)
        self._done += 1
        self._on_done(self._done)
        return analysed

    def error(self, setup: Setup) -> float:
        """Return the predicted mean total error of a setup, NaN if no plan was found."""
        return _error(self.steering(setup))


def _error(analysed: Steering | None) -> float:
    return math.nan if analysed is None else analysed.error


def most_alike(setup: Setup) -> tuple[int, int] | None:
    """Return the indices of the two robots whose turning rates a differ least, the slower first;
    None for one robot."""
    order = np.argsort(setup.a, kind="stable")
    if len(order) < 2:
        return None
    gaps = setup.a[order[1:]] / setup.a[order[:-1]] - 1
    least = int(np.argmin(gaps))
    slower, faster = order[least : least + 2].tolist()
    return slower, faster


def _gap(setup: Setup, slower: int, faster: int) -> float:
    """Return the difference of the turning rates of two robots, relative to the smaller one."""
    return float(setup.a[faster] / setup.a[slower] - 1)


def respaced(setup: Setup, gap: float) -> Setup:
    """Return the setup with other turning rates a: each is 1 + `gap` times the next lower one, and
    their geometric mean is unchanged."""
    rank = np.argsort(np.argsort(setup.a, kind="stable"))
    middle = np.exp(np.log(setup.a).mean())
    return replace(setup, a=middle * (1 + gap) ** (rank - (len(rank) - 1) / 2))


def _rates_to_try(setup: Setup, slower: int, faster: int) -> Iterator[tuple[int, float]]:
    """Yield an index of one of the two robots most alike, and another a for it, of three digits as
    is advised, which raises the least gap: the faster one turns faster, or the slower one more
    slowly."""
    gap = _gap(setup, slower, faster)
    for step in STEPS:
        higher = float(f"{setup.a[slower] * (1 + step):.3g}")
        lower = float(f"{setup.a[faster] / (1 + step):.3g}")
        for robot, a in ((faster, higher), (slower, lower)):
            changed = _with_rate(setup, robot, a)
            closest = most_alike(changed)
            assert closest is not None
            if _gap(changed, *closest) > max(gap, GAP_OF_STEP * step):
                yield robot, a


def _with_rate(setup: Setup, robot: int, a: float) -> Setup:
    """Return the setup with another turning rate of a robot."""
    rates = setup.a.copy()
    rates[robot] = a
    return replace(setup, a=rates)


def best_change(changes: list[Change], error: float) -> Change | None:
    """Return the smallest change whose error is at most `AS_GOOD` times the least, None if no
    change helps.

    `error` is the error without a change; an error is NaN if no plan was found.
    """
    most = math.inf if math.isnan(error) else WORTH * error
    helpful = [change for change in changes if change.mean_total_error <= most]
    if not helpful:
        return None
    least = min(change.mean_total_error for change in helpful)
    as_good = [change for change in helpful if change.mean_total_error <= AS_GOOD * least]
    return min(as_good, key=lambda change: abs(np.log(change.a_advised / change.a)))

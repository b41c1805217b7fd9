"""Ranks choices of cells in a dish by the total error predicted for steering them together."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

from tetractl.analysis.closed_loop import Noise
from tetractl.analysis.steering import planner, steering
from tetractl.experiment.choice import FoundCell
from tetractl.experiment.choosing import settled, worth
from tetractl.experiment.experiment import Experiment

COMPARED = 40  # number of choices whose errors are predicted: those with the most different a
# for each round, the fraction of the choices that are compared, and of the plans that are used
ROUNDS = ((1.0, 1 / 12), (0.3, 1 / 3), (0.1, 1.0))
# difference of log(a) below which cells cannot be distinguished in time after they meet
ALIKE = 0.08


@dataclass(frozen=True, slots=True)
class RankedChoice:
    """A choice of cells, in the order of falling turning rates, and its predicted mean total error
    [length unit], inf if no plan reaches the targets."""

    cells: tuple[FoundCell, ...]
    error: float


def ranked(
    experiment: Experiment,
    cells: Sequence[FoundCell],
    noise: Noise,
    plans: int,
    on_done: Callable[[int, int], object] = lambda *_: None,
) -> list[RankedChoice]:
    """Return the best choices of cells for an experiment that chooses its robots, best first.

    Errors are predicted as by `tetractl analyze`, from the cells' poses: first along a few plans
    for the COMPARED choices of greatest `worth`, then along more, up to `plans`, for the best of
    them (successive halving), with the same random numbers. If no plan reaches the targets in the
    first round, there are no further ones. Only cells with a magnet count; [] if
    there are too few.
    """
    choice = experiment.chosen
    assert choice is not None, "the spec must have robots: {choose: N}"
    able = sorted((cell for cell in cells if cell.magnetised), key=lambda cell: -cell.a)
    every = sorted(combinations(able, choice.choose), key=lambda some: worth(some, experiment))
    found = [RankedChoice(some, math.inf) for some in every[: -COMPARED - 1 : -1]]
    counts = [min(max(5, round(share * len(found))), len(found)) for share, _ in ROUNDS]
    done = 0
    for count, (_, share) in zip(counts, ROUNDS, strict=True):
        for i in range(count):
            some = found[i].cells
            error = predicted(experiment, some, noise, math.ceil(share * plans))
            found[i] = RankedChoice(some, error)
            done += 1
            on_done(done, sum(counts))
        found[:count] = sorted(found[:count], key=lambda one: one.error)
        if found and math.isinf(found[0].error):
            break  # no plan reaches the targets, and more plans of the same choices would not
    return found[: counts[-1]]


def predicted(
    experiment: Experiment, cells: Sequence[FoundCell], noise: Noise, plans: int
) -> float:
    """Return the mean total error [length unit] predicted for a choice of cells, inf if no plan
    reaches the targets."""
    trial = settled(experiment, cells)
    result = steering(planner(trial), trial.setup, noise, trial.trials.seed, plans)
    return math.inf if result is None else result.error


def alike(cells: Sequence[FoundCell]) -> Iterator[tuple[FoundCell, FoundCell]]:
    """Yield pairs of cells with turning rates too similar to tell them apart after they meet."""
    for one, two in combinations([cell for cell in cells if cell.magnetised], 2):
        if abs(math.log(one.a / two.a)) < ALIKE:
            yield one, two

"""Which cells of a dish can be steered together, and how well."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

from tetractl.analysis.closed_loop import Noise
from tetractl.analysis.steering import planner, steering
from tetractl.experiment.choice import FoundCell
from tetractl.experiment.choosing import settled, worth
from tetractl.experiment.experiment import Experiment

COMPARED = 40  # choices of cells whose errors are predicted: those with the most different a
# shares of these that are compared, and along which share of the plans
ROUNDS = ((1.0, 1 / 12), (0.3, 1 / 3), (0.1, 1.0))
LEAST = 5  # compared in each round, if there are as many
# difference of the logarithms of a below which cells cannot be distinguished in time
ALIKE = 0.08


@dataclass(frozen=True, slots=True)
class RankedChoice:
    """Some cells, the fastest turning first, and their predicted mean total error [length unit],
    inf if no plan reaches the targets."""

    cells: tuple[FoundCell, ...]
    error: float


def ranked(
    experiment: Experiment,
    cells: Sequence[FoundCell],
    noise: Noise,
    plans: int,
    on_done: Callable[[int, int], object] = lambda *_: None,
) -> list[RankedChoice]:
    """Return the best choices of cells for an experiment that leaves them open, the best first.

    Errors are predicted as by `tetractl analyze`, from the cells' poses. The best choices along a
    few plans are compared along more, up to the given number (successive halving), with the same
    random numbers for all choices. Only cells with a magnet count; [] if there are too few.
    """
    choice = experiment.chosen
    assert choice is not None, "only a spec that leaves its robots open chooses"
    able = sorted((cell for cell in cells if cell.magnetised), key=lambda cell: -cell.a)
    every = sorted(combinations(able, choice.choose), key=lambda some: worth(some, experiment))
    found = [RankedChoice(some, math.inf) for some in every[: -COMPARED - 1 : -1]]
    counts = [min(max(LEAST, round(share * len(found))), len(found)) for share, _ in ROUNDS]
    done = 0
    for count, (_, share) in zip(counts, ROUNDS, strict=True):
        for i in range(count):
            some = found[i].cells
            error = predicted(experiment, some, noise, math.ceil(share * plans))
            found[i] = RankedChoice(some, error)
            done += 1
            on_done(done, sum(counts))
        found[:count] = sorted(found[:count], key=lambda one: one.error)
    return found[: counts[-1]]


def predicted(
    experiment: Experiment, cells: Sequence[FoundCell], noise: Noise, plans: int
) -> float:
    """Return the mean total error predicted for some cells [length unit], inf if no plan reaches
    the targets."""
    trial = settled(experiment, cells)
    result = steering(planner(trial), trial.setup, noise, trial.trials.seed, plans)
    return math.inf if result is None else result.error


def alike(cells: Sequence[FoundCell]) -> Iterator[tuple[FoundCell, FoundCell]]:
    """Yield pairs of cells that turn too much alike to be distinguished after they meet."""
    for one, two in combinations([cell for cell in cells if cell.magnetised], 2):
        if abs(math.log(one.a / two.a)) < ALIKE:
            yield one, two

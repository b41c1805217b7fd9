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

COMPARED = 12  # choices of cells whose errors are predicted: those with the most different a
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
    """Return choices of cells for an experiment that leaves them open, the best first.

    Errors are predicted as by `tetractl analyze`, along a given number of plans each, from the
    cells' poses. Only cells with a magnet count; [] if there are too few.
    """
    choice = experiment.chosen
    assert choice is not None, "only a spec that leaves its robots open chooses"
    able = sorted((cell for cell in cells if cell.magnetised), key=lambda cell: -cell.a)
    every = sorted(combinations(able, choice.choose), key=lambda some: worth(some, experiment))
    found = []
    for some in every[: -COMPARED - 1 : -1]:
        trial = settled(experiment, some)
        result = steering(planner(trial), trial.setup, noise, trial.trials.seed, plans)
        found.append(RankedChoice(some, math.inf if result is None else result.error))
        on_done(len(found), min(len(every), COMPARED))
    return sorted(found, key=lambda one: one.error)


def alike(cells: Sequence[FoundCell]) -> Iterator[tuple[FoundCell, FoundCell]]:
    """Yield pairs of cells that turn too much alike to be distinguished after they meet."""
    for one, two in combinations([cell for cell in cells if cell.magnetised], 2):
        if abs(math.log(one.a / two.a)) < ALIKE:
            yield one, two

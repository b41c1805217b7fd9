"""Ranks choices of cells in a dish by the total error predicted for steering them together."""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations, islice

import numpy as np

from tetractl.spec.experiment import Experiment
from tetractl_microscope.choice.candidate import RobotCandidate
from tetractl_microscope.choice.choosing import rate_choice, set_robots
from tetractl_microscope.choice.closed_loop import (
    Noise,
    compute_mean_errors,
    linearise_plan,
    predict_end_covariance,
)
from tetractl_microscope.choice.first_plans import search_first_plans, select_planner
from tetractl_microscope.choice.section import require_choice

COMPARED = 40  # number of choices whose errors are predicted: those with the most different a
# for each round, the fraction of the choices that are compared, and of the plans that are used
ROUNDS = ((1.0, 1 / 12), (0.3, 1 / 4), (0.1, 1.0))
PLANS_MAX = 1000  # largest number of plans of a choice
# difference of log(a) below which cells cannot be distinguished in time after they meet
SIMILAR_LOG_DIFFERENCE = 0.08


class RankedChoice:
    """A choice of cells, with the errors predicted along the first plans of its trials.

    Args:
        experiment: The experiment.
        cells: The cells of the choice.
        noise: The noise of the robots and the camera.
    """

    def __init__(
        self, experiment: Experiment, cells: Sequence[RobotCandidate], noise: Noise
    ) -> None:
        self.cells = tuple(cells)
        self._errors: list[float] = []  # of plans that reach the targets
        self._remaining_errors = self._predictions(set_robots(experiment, cells), noise)
        self._tried_count = 0

    @staticmethod
    def _predictions(trial: Experiment, noise: Noise) -> Iterator[float | None]:
        """Predict the mean total error [length unit] along each plan.

        Yields:
            The error, or None if the plan does not reach the targets.
        """
        section = select_planner(trial)
        problem = section.problem(trial.setup)
        for plan in search_first_plans(section, trial.setup, trial.trials.seed, PLANS_MAX):
            if plan is None:
                yield None
                continue
            linear = linearise_plan(problem, plan.signals)
            covariance = predict_end_covariance(linear, noise, True, section.estimate)
            yield float(compute_mean_errors(covariance, linear.target_distances).sum())

    def along(self, count: int) -> "RankedChoice":
        """Predict the errors along the first `count` plans, except those predicted before.

        Returns:
            The choice itself.
        """
        for error in islice(self._remaining_errors, max(0, count - self._tried_count)):
            self._tried_count += 1
            if error is not None:
                self._errors.append(error)
        return self

    @property
    def error(self) -> float:
        """The predicted mean total error [length unit]: the median over the plans so far.

        It is inf if no plan reaches the targets.
        """
        return float(np.median(self._errors)) if self._errors else math.inf

    @property
    def numbers(self) -> list[int]:
        """The numbers of the cells that this choice would use as robots."""
        return [cell.number for cell in self.cells]


def rank_choices(
    experiment: Experiment,
    cells: Sequence[RobotCandidate],
    noise: Noise,
    plans: int,
    on_done: Callable[[int, int], object] = lambda *_: None,
) -> list[RankedChoice]:
    """Rank choices of cells by the total error predicted for steering them together.

    Errors are predicted with a linearised closed loop that starts at the cells' poses. In the first
    round, a few plans are tried for the COMPARED choices that `rate_choice` rates highest. In later
    rounds, more plans are tried for the best choices only (successive halving). All choices use the
    same random numbers. If no plan reaches the targets in the first round, there are no further
    rounds.

    Only cells that respond to the field are chosen, and no choice contains two similar cells. A
    choice with a cell near the edge, whose turning rate is unreliable, ranks below all other
    choices that reach the targets.

    Args:
        experiment: An experiment whose spec has `robots: {choose: N}`.
        cells: The cells to choose from.
        noise: The noise of the robots and the camera.
        plans: Maximum number of plans for each choice.
        on_done: Called after each prediction with the number of predictions so far and their total
            number.

    Returns:
        The choices of the last round, best first. Empty if there is no possible choice.
    """
    choice = require_choice(experiment)
    responding_cells = sorted((cell for cell in cells if cell.magnetised), key=lambda cell: -cell.a)
    distinguishable = [
        chosen
        for chosen in combinations(responding_cells, choice.choose)
        if not any(find_similar_pairs(chosen))
    ]
    sorted_choices = sorted(
        distinguishable,
        key=lambda chosen: (all(cell.free for cell in chosen), rate_choice(chosen, experiment)),
    )
    candidates = [
        RankedChoice(experiment, chosen, noise) for chosen in sorted_choices[: -COMPARED - 1 : -1]
    ]
    n_choices = len(candidates)
    counts = [min(max(5, round(fraction * n_choices)), n_choices) for fraction, _ in ROUNDS]
    done_count = 0
    for count, (_, fraction) in zip(counts, ROUNDS, strict=True):
        for candidate in candidates[:count]:
            candidate.along(math.ceil(fraction * plans))
            done_count += 1
            on_done(done_count, sum(counts))
        candidates[:count] = sorted(candidates[:count], key=_sort_key)
        if candidates and math.isinf(candidates[0].error):
            break  # no plan reaches the targets, and more plans of the same choices would not
    return candidates[: counts[-1]]


def _sort_key(candidate: RankedChoice) -> tuple[bool, bool, float]:
    """Compute the sort key of a choice of cells. The best choice has the smallest key.

    Choices with a plan come first, then those without a cell near the edge, then small errors.
    """
    is_uncertain = not all(cell.free for cell in candidate.cells)
    return math.isinf(candidate.error), is_uncertain, candidate.error


def find_similar_pairs(
    cells: Sequence[RobotCandidate],
) -> Iterator[tuple[RobotCandidate, RobotCandidate]]:
    """Yield pairs of cells whose turning rates are too similar to distinguish them after they meet.

    Cells that do not respond to the field are ignored.
    """
    for first, second in combinations([cell for cell in cells if cell.magnetised], 2):
        if abs(math.log(first.a / second.a)) < SIMILAR_LOG_DIFFERENCE:
            yield first, second

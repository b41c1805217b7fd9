"""The recommended optimiser `multistart`: try many random plans, and improve the best of them.

A rollout is the simulation of one sequence of signals. The paper's particle swarm needs some ten
thousand rollouts, because it uses only their costs. The cost, equation (8) of the paper, is smooth,
its gradient costs about as much as a rollout, and there are far fewer misses (two coordinates per
robot) than signals. Therefore the Levenberg-Marquardt method
(`tetractl.control.search.kernels.levenberg`) improves ("polishes") about every third smooth random
sequence until it reaches the targets, in a few dozen steps. Global decisions, such as the side on
which to pass an obstacle, are made by random starts and selection: each round draws many smooth
sequences, evaluates them in one vectorised rollout and polishes only the best.
"""

from threading import get_ident
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from tetractl.control.search.cost import require_finite
from tetractl.core.plan import Limits, Problem, Search, StopReason
from tetractl.core.poses import Floats
from tetractl.spec.base import Positive
from tetractl.spec.controller import OptimizerSection

if TYPE_CHECKING:
    from tetractl.control.search.kernels.multistart import Rounds, SearchTask


class Multistart(OptimizerSection):
    """The recommended optimiser: tries many random plans, and improves the best of them.

    See docs/explanation/controller.md.

    Each round generates `particles` smooth random sequences of signals, computes their costs, and
    polishes the best `polished` of them by the Levenberg-Marquardt method, until one has a cost of
    at most `tolerance`.
    """

    type: Literal["multistart"] = "multistart"
    particles: int = Field(default=128, ge=1, le=1_000_000)
    """Number of random sequences generated in each round."""
    knots: int = Field(default=12, ge=2, le=1000)
    """Number of random directions that each scattered sequence passes through, evenly spread over
    its length.
    """
    polished: int = Field(default=4, ge=1, le=10_000)
    """Number of sequences polished in each round: those with the lowest costs."""
    rounds: int = Field(default=10, ge=1, le=10_000)
    """Number of rounds of a search without a warm start.

    With a warm start, there is one round, and only if polishing the start fails.
    """
    grows: bool = True
    """Whether `knots` and the iterations that polish a start are multiplied by (N / 3)^2 if there
    are more than three robots.
    """
    tolerance: Positive = 0.001
    """Cost J at which a sequence is good enough and the search ends [length unit]."""

    slack: ClassVar[float] = 0.01
    """Clearance to which a path is pushed out of an obstacle.

    The unit is the distance that the fastest robot drives during one signal.
    """
    steps: ClassVar[int] = 40
    """Maximum number of Levenberg-Marquardt iterations for one start."""
    patience: ClassVar[int] = 6
    """A polish ends if the merit has not fallen by a fifth within this many iterations."""

    @property
    def iterations_max(self) -> int:
        """Maximum number of Levenberg-Marquardt iterations per start, for up to three robots."""
        return self.steps

    @property
    def evaluations_min(self) -> int:
        """Minimum number of cost evaluations that a search needs: one round and the warm start."""
        return self.particles + 1

    @property
    def good_enough(self) -> float:
        """The cost J at which a sequence is good enough: `tolerance`."""
        return self.tolerance

    def growth_factor(self, problem: Problem) -> float:
        """Return the factor by which settings grow with the number of robots, at least 1.

        It multiplies `knots`, `steps` and `patience`. The factor is 1 if `grows` is False.
        """
        return max(1.0, np.square(len(problem.a) / 3)) if self.grows else 1.0

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search from the previous plan `warm`, or from random sequences; see `Optimizer.search`.

        The previous plan, called the warm start, is polished first. If that fails, one round is
        scattered, half of it around the warm start. The history contains J before and after each
        polish and, in between, the merit of its steps: f of the paper's equation (8) plus the
        depths inside obstacles.
        """
        from tetractl.control.search.kernels import levenberg, motion, multistart, rollout

        growth = self.growth_factor(problem)
        longest_step = float(problem.speed.max()) * problem.period
        iterations_max = round(self.steps * growth)
        rounds = multistart.rounds_for(  # arrays that the next search of this thread uses again
            thread=get_ident(),
            count=min(self.polished, self.particles),
            particles=self.particles,
            knots=min(round(self.knots * growth), length),
            length=length,
            steps_max=iterations_max,
            rounds=self.rounds,
        )
        settings = levenberg.PolishSettings(
            tolerance=self.tolerance,
            slack=self.slack * longest_step,
            patience=round(self.patience * growth),
            iterations_max=iterations_max,
        )
        task = multistart.SearchTask(
            problem=motion.flatten(problem),
            rollouts=rollout.rollouts_of(get_ident(), problem.a.size, self.particles),
            workspace=levenberg.workspace_for(problem, length),
            settings=settings,
            key=np.uint64(key),
            warm=np.empty(0) if warm is None else warm,
            rounds=self._rounds_max(problem, length) if warm is None else 1,
            budget=multistart.UNLIMITED if limits.evaluations is None else limits.evaluations,
        )
        if warm is None:
            rounds.begin(multistart.SCATTER, np.empty((0, length)))
        else:
            rounds.begin(multistart.WARM, warm[None])
        if limits.timed:
            robot_steps = len(task.workspace.residual) * length * problem.a.size
            iterations = max(1, multistart.ROBOT_STEPS_PER_CHECK // robot_steps)
            stop_reason = _search_until_deadline(task, rounds, iterations, limits)
        else:
            stop_reason = _stop_reason(multistart.search(task, rounds, multistart.UNLIMITED))
        return Search(
            length=length,
            signals=rounds.best.copy(),
            cost=float(rounds.state.best_cost),
            history=np.minimum.accumulate(rounds.history[: rounds.state.history_entries]),
            evaluations=int(rounds.state.evaluations),
            stopped=stop_reason,
        )

    def _rounds_max(self, problem: Problem, length: int) -> int:
        """Return the maximum number of rounds: `rounds`, or 1 if the targets are out of reach.

        Targets are out of reach if even straight lines of `length` signals end too far from them.
        """
        distances = problem.poses.distances(problem.targets)
        reach = problem.speed * problem.seconds(length)
        shortfall = float(np.maximum(distances - reach, 0.0).sum())
        return 1 if shortfall > self.tolerance else self.rounds


def _search_until_deadline(
    task: "SearchTask", rounds: "Rounds", iterations: int, limits: Limits
) -> StopReason:
    """Run a search until it ends or its deadline has passed, and return why it ended.

    At the deadline, the polish under way ends as it is. The first polish may therefore end before
    it has improved its start. The reason is then the deadline, even if the result is good enough.

    Args:
        task: What to search.
        rounds: The arrays and the state of the search.
        iterations: Number of iterations between two checks of the deadline.
        limits: The limits of the search, with the deadline.
    """
    from tetractl.control.search.kernels import multistart

    # evaluations if the search ended now, so that a rerun can end at the same check
    evaluations = rounds.evaluations_if_finished()
    while not limits.expired(evaluations):
        end_code = multistart.search(task, rounds, iterations)
        if end_code != multistart.UNDER_WAY:
            return _stop_reason(end_code)
        evaluations = rounds.evaluations_if_finished()
    if evaluations > rounds.state.evaluations:
        _stop_reason(multistart.finish(task, rounds))
    return StopReason.DEADLINE


def _stop_reason(end_code: int) -> StopReason:
    """Convert the end code of a compiled search to a reason.

    Raises:
        ControlError: If a cost is not finite.
    """
    from tetractl.control.search.kernels import multistart

    match end_code:
        case multistart.GOOD:
            return StopReason.TARGET
        case multistart.SPENT:
            return StopReason.EVALUATIONS
        case multistart.NOT_FINITE:
            require_finite(np.array([np.nan]))
        case _:
            pass
    return StopReason.ITERATIONS  # all rounds are done

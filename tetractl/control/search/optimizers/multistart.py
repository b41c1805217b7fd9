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

    def growth(self, problem: Problem) -> float:
        """Return the factor, at least 1, by which settings grow with the number of robots.

        The settings are `knots`, `steps` and `patience`. The factor is 1 if `grows` is False.
        """
        return max(1.0, np.square(len(problem.a) / 3)) if self.grows else 1.0

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search from the previous plan `warm`, or from random sequences; see `Optimizer.search`.

        The previous plan, called the warm start, is polished first. If that fails, one round is
        scattered, half of it around the warm start. The history holds J before and after each
        polish and, in between, the merit of its steps: f of the paper's equation (8) plus the
        depths inside obstacles.
        """
        from tetractl.control.search.kernels import levenberg, motion, multistart, rollout

        growth = self.growth(problem)
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
            room=levenberg.room_for(problem, length),
            settings=settings,
            key=np.uint64(key),
            warm=np.empty(0) if warm is None else warm,
            rounds=self._rounds(problem, length) if warm is None else 1,
            budget=multistart.UNLIMITED if limits.evaluations is None else limits.evaluations,
        )
        if warm is None:
            rounds.begin(multistart.SCATTER, np.empty((0, length)))
        else:
            rounds.begin(multistart.WARM, warm[None])
        if limits.timed:
            robot_steps = len(task.room.residual) * length * problem.a.size
            iterations = max(1, multistart.BETWEEN_LOOKS // robot_steps)
            stopped = _stopped_in_time(task, rounds, iterations, limits)
        else:
            stopped = _reason(multistart.search(task, rounds, multistart.UNLIMITED))
        return Search(
            length=length,
            signals=rounds.best.copy(),
            cost=float(rounds.state.best_cost),
            history=np.minimum.accumulate(rounds.history[: rounds.state.history_entries]),
            evaluations=int(rounds.state.evaluations),
            stopped=stopped,
        )

    def _rounds(self, problem: Problem, length: int) -> int:
        """Return the number of rounds: `rounds`, or 1 if the targets are out of reach.

        They are out of reach if even straight lines of `length` signals end too far from them.
        """
        gaps = problem.poses.distances(problem.targets)
        reach = problem.speed * problem.seconds(length)
        beyond = float(np.maximum(gaps - reach, 0.0).sum())
        return 1 if beyond > self.tolerance else self.rounds


def _stopped_in_time(
    task: "SearchTask", rounds: "Rounds", iterations: int, limits: Limits
) -> StopReason:
    """Run a search until it ends or its deadline has come, and return why it ended.

    The clock is checked after every `iterations`. At the deadline, the polish under way ends as it
    is. If it is the first one, it may end before it has improved its start. The reason is then the
    deadline, even if the result is good enough.
    """
    from tetractl.control.search.kernels import multistart

    # what the search spends if it ends now, so that a rerun of it can end at the same look
    evaluations = rounds.evaluations_if_finished()
    while not limits.expired(evaluations):
        end = multistart.search(task, rounds, iterations)
        if end != multistart.UNDER_WAY:
            return _reason(end)
        evaluations = rounds.evaluations_if_finished()
    if evaluations > rounds.state.evaluations:
        _reason(multistart.finish(task, rounds))
    return StopReason.DEADLINE


def _reason(end: int) -> StopReason:
    """Convert the code with which a compiled search ends to a reason.

    Raises:
        ControlError: If a cost is not finite.
    """
    from tetractl.control.search.kernels import multistart

    match end:
        case multistart.GOOD:
            return StopReason.TARGET
        case multistart.SPENT:
            return StopReason.EVALUATIONS
        case multistart.NOT_FINITE:
            require_finite(np.array([np.nan]))
        case _:
            pass
    return StopReason.ITERATIONS  # all rounds are done

"""Repeats a logged search to obtain its particle swarm, which logs do not contain.

A controller that is rebuilt from the log repeats control step 0, and receives the logged results of
its searches. The problem, the warm start and the random key that it passes to `search` determine
the swarm. The module also checks whether the costs equal the logged ones, which the figure `swarm`
reports.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from tetractl.control.search.evaluate import compiled_costs
from tetractl.control.search.optimizers.pso import Pso
from tetractl.core.errors import LogError, TetractlError
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats
from tetractl.log.read.trial_log import TrialLog
from tetractl.model.motion.motion import LOWER, UPPER
from tetractl.run.spec_trial import trial_seeds
from tetractl.verification.recompute import NoSearchError, SearchRequest, StepSearches

GRID = 61
SEEN = [0, 1]
"""Indices, in a sequence of signals, of the two signals on the axes of the figure."""


@dataclass(frozen=True, slots=True)
class Frame:
    """The swarm after one iteration.

    Attributes:
        z: Index of the iteration.
        particles: The first two signals of each particle [rad], shape (number of particles, 2).
        best: The first two signals of the best sequence found so far, u_gb [rad], shape (2,).
        cost: Cost J of that sequence.
    """

    z: int
    particles: Floats
    best: Floats
    cost: float


@dataclass(frozen=True, slots=True)
class SwarmHistory:
    """The history of a particle swarm search, reduced to the first two signals of each sequence.

    Attributes:
        frames: The swarm after the chosen iterations.
        path: Path of the first particle over Z iterations [rad], shape (Z + 1, 2).
        path_best: Best point that this particle found [rad], shape (2,).
        costs: J on a grid over the range of the two signals, with the lowest row first, shape
            (GRID, GRID). The range is given by the paper's equation (12). All other signals are
            taken from u_gb, the best sequence found.
        repeated: Whether J(u_gb) equals the logged cost in every iteration.
    """

    frames: tuple[Frame, ...]
    path: Floats
    path_best: Floats
    costs: Floats
    repeated: bool


def first_swarm(log: TrialLog, shares: Sequence[float]) -> SwarmHistory:
    """Repeat the chosen search of control step 0, and record its swarm.

    Args:
        log: The log of the trial.
        shares: Iterations to keep as frames, each as a fraction of all iterations, from 0 to 1.

    Raises:
        LogError: If the search was not by a particle swarm, has only one signal, cannot be repeated
            from the log, or takes too long.
    """
    searches = StepSearches(search_again=False)
    request = _first_request(log, searches)
    section = request.optimizer
    if not isinstance(section, Pso):
        raise LogError(
            f"{log.log}: the log has no particle swarm, because its optimiser is {section.type}",
            "run the trial with --set controller.optimizer.type=pso",
            'run the trial with "controller.optimizer.type=pso"',
        )
    if request.length < 2:
        raise LogError(f"{log.log}: the plan has only one signal, but this figure needs two")
    logged_costs = log.steps[0].plan.search.history
    last = min(len(logged_costs) - 1, section.iterations)
    wanted = {round(share * last) for share in shares}
    frames: list[Frame] = []
    path: list[Floats] = []
    costs: list[float] = []
    swarm = section.create_swarm(request.problem, request.length, request.warm, request.key)
    for z in range(last + 1):
        if searches.is_expired():
            raise LogError(f"{log.log}: running the first search of the trial again takes too long")
        if z > 0:
            swarm.iterate()
        particles = swarm.u[SEEN].T.copy()
        path.append(particles[0])
        costs.append(swarm.global_best.cost)
        if z in wanted:
            frames.append(
                Frame(z, particles, swarm.global_best.signals[SEEN], swarm.global_best.cost)
            )
    return SwarmHistory(
        tuple(frames),
        np.array(path),
        swarm.u_lb[SEEN, 0],
        _landscape(request.problem, swarm.global_best.signals),
        bool(np.array_equal(costs, logged_costs)),
    )


def _first_request(log: TrialLog, searches: StepSearches) -> SearchRequest:
    """Let the log's controller repeat control step 0, and return its request for the chosen search.

    Raises:
        LogError: If the controller does not request this search.
    """
    step = log.steps[0]
    searches.start_step(step.plan.searches)
    key, _ = trial_seeds(log.start.seed, log.start.trial)
    with suppress(TetractlError, NoSearchError):  # the searches before the error are recorded
        searches.controller(log, key).plan(step.observation)
    request = searches.requests.get(step.plan.chosen)
    if step.k != 0 or request is None:
        raise LogError(
            f"{log.log}: the first search of the trial cannot be repeated",
            "`tetractl verify` prints where a repetition differs from the log",
        )
    return request


def _landscape(problem: Problem, u_gb: Floats) -> Floats:
    """Compute J [length unit] on a grid over the first two signals, shape (GRID, GRID).

    Columns are values of the first signal, rows are values of the second. The other signals
    are taken from `u_gb`.
    """
    axis = np.linspace(LOWER, UPPER, GRID)
    costs = np.empty((GRID, GRID))
    cost_of = compiled_costs(problem, GRID)
    for row, value in enumerate(axis):
        signals = np.repeat(u_gb[None], GRID, axis=0)
        signals[:, SEEN] = np.column_stack([axis, np.full(GRID, value)])
        costs[row] = cost_of(np.ascontiguousarray(signals.T))
    return costs

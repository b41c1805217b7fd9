"""Repeats a logged search to obtain its particle swarm, which the log does not contain.

A controller is rebuilt from the log. It repeats control step 0, and receives the logged results of
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

GRID_SIZE = 61  # number of grid points of the cost J along each axis
SHOWN_SIGNALS = [0, 1]
"""Indices of the two signals of a sequence that the axes of the figure show."""


@dataclass(frozen=True, slots=True)
class SwarmFrame:
    """A particle swarm after one iteration of its search.

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
        frames: The swarm after each of the chosen iterations.
        path: Path of the first particle over Z iterations [rad], shape (Z + 1, 2).
        path_best: Best point that this particle found [rad], shape (2,).
        costs: Cost J on a grid over the range of the two signals, with the lowest row first, shape
            (GRID_SIZE, GRID_SIZE). The range is given by the paper's equation (12). All other
            signals are taken from u_gb, the best sequence found.
        repeated: Whether J(u_gb) equals the logged cost in every iteration.
    """

    frames: tuple[SwarmFrame, ...]
    path: Floats
    path_best: Floats
    costs: Floats
    repeated: bool


def repeat_first_search(log: TrialLog, frame_fractions: Sequence[float]) -> SwarmHistory:
    """Repeat the search that found the plan of a trial's step 0, and record its particle swarm.

    Args:
        log: The log of the trial.
        frame_fractions: Iterations to keep as frames, each as a fraction of all iterations, from 0
            to 1.

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
    last_iteration = min(len(logged_costs) - 1, section.iterations)
    frame_iterations = {round(share * last_iteration) for share in frame_fractions}
    frames: list[SwarmFrame] = []
    path: list[Floats] = []
    costs: list[float] = []
    swarm = section.create_swarm(request.problem, request.length, request.warm, request.key)
    for z in range(last_iteration + 1):
        if searches.is_expired():
            raise LogError(f"{log.log}: running the first search of the trial again takes too long")
        if z > 0:
            swarm.iterate()
        particles = swarm.u[SHOWN_SIGNALS].T.copy()
        path.append(particles[0])
        costs.append(swarm.global_best.cost)
        if z in frame_iterations:
            frames.append(
                SwarmFrame(
                    z, particles, swarm.global_best.signals[SHOWN_SIGNALS], swarm.global_best.cost
                )
            )
    return SwarmHistory(
        tuple(frames),
        np.array(path),
        swarm.u_lb[SHOWN_SIGNALS, 0],
        _compute_cost_grid(request.problem, swarm.global_best.signals),
        bool(np.array_equal(costs, logged_costs)),
    )


def _first_request(log: TrialLog, searches: StepSearches) -> SearchRequest:
    """Let a trial's controller repeat step 0, and return its request for the chosen search.

    Raises:
        LogError: If the controller does not request this search again.
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


def _compute_cost_grid(problem: Problem, u_gb: Floats) -> Floats:
    """Compute the cost J [length unit] on a grid over the first two signals of a sequence.

    The result has the shape (GRID_SIZE, GRID_SIZE).

    Columns are values of the first signal, rows are values of the second. The other signals
    are taken from `u_gb`.
    """
    axis_rad = np.linspace(LOWER, UPPER, GRID_SIZE)
    costs = np.empty((GRID_SIZE, GRID_SIZE))
    compute_costs = compiled_costs(problem, GRID_SIZE)
    for row, value in enumerate(axis_rad):
        signals = np.repeat(u_gb[None], GRID_SIZE, axis=0)
        signals[:, SHOWN_SIGNALS] = np.column_stack([axis_rad, np.full(GRID_SIZE, value)])
        costs[row] = compute_costs(np.ascontiguousarray(signals.T))
    return costs

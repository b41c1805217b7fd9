"""Repeat each decision of a logged trial with a controller that is rebuilt from the log.

`recompute` goes through the steps: `_step_difference` lets the controller decide on the logged
frames, and compares. `StepSearches.search` answers the controller's searches in one of two ways.
*Re-computed*: every search is run again and must give the same bits, as it does on the machine and
with the versions that wrote the log. *Re-evaluated*: the searches' results are read from the log;
their J, the choice among them and the predicted path are computed again, and must agree within
RELATIVE_TOLERANCE and ABSOLUTE_TOLERANCE. Searches cannot be repeated on another processor: a
difference in the last bit of one cost may change the leading particle and then the whole search.
"""

import copy
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tetractl.control.search.cost import evaluate
from tetractl.control.search.optimizers.pso import Pso
from tetractl.control.search.stop import reason_to_stop
from tetractl.core.clock import SECOND
from tetractl.core.errors import TetractlError
from tetractl.core.loggable import DRAWING_PRECISION, round_for_drawing
from tetractl.core.plan import (
    PAUSE_S,
    Decision,
    End,
    Limits,
    Outcome,
    Plan,
    Problem,
    Search,
    StopReason,
)
from tetractl.core.poses import Floats, Observation
from tetractl.core.protocols import Controller
from tetractl.core.trial import Step
from tetractl.log.read.limits import FACTOR_VARIABLE, seconds_limit
from tetractl.log.read.trial_log import TrialLog, frame_gaps
from tetractl.run.checked_controller import CheckedController
from tetractl.run.spec_trial import trial_seeds
from tetractl.spec.controller import Host, OptimizerSection
from tetractl.spec.experiment import find_packages
from tetractl.tools.kernels.kernel_cache import computing_s
from tetractl.tools.plugin_fault import name_plugins_in_errors
from tetractl.verification.comparison import (
    SAME_BITS,
    Difference,
    Tolerance,
    Unchecked,
    first_difference,
)

RELATIVE_TOLERANCE = 1e-9
"""Relative tolerance of re-evaluation."""
ABSOLUTE_TOLERANCE = 1e-12
"""Additional tolerance relative to the largest coordinate.

A cost near 0 is a small difference of much larger coordinates.
"""
AFTER_EVERY_DEADLINE_NS = 1 << 62
"""A time that is later than every deadline of a controller [ns]."""


# ---- The decisions of a trial ----


@dataclass(frozen=True, slots=True)
class Recomputed:
    """The result of repeating the decisions of a log: how many of them agree.

    Attributes:
        agreeing_steps: Number of steps before the first difference.
        difference: The first difference. None if all agree.
    """

    agreeing_steps: int
    difference: Difference | None


def recompute(
    log: TrialLog, search_again: bool, read_cpu_s: Callable[[], float] = computing_s
) -> Recomputed:
    """Compute every decision of a log again, up to the first decision that differs.

    Steps after a gap are not checked, because the controller's state is lost. If the processor time
    exceeds its limit, the difference is an `Unchecked`. Compiling does not count.

    Args:
        log: The log.
        search_again: Whether to run the searches again and compare bits. If False, the logged
            searches are used.
        read_cpu_s: Returns the processor time [s].
    """
    try:
        key, _ = trial_seeds(log.start.seed, log.start.trial)
    except (ValueError, OverflowError):
        message = f"with the seed {log.start.seed}, there is no trial {log.start.trial}"
        return Recomputed(0, Difference(None, "seed", message))
    searches = StepSearches(search_again, read_cpu_s)
    controller = searches.controller(log, key)
    setup = log.start.setup
    tolerance = SAME_BITS
    if not search_again:
        tolerance = _evaluation_tolerance(setup.starts.xy, setup.targets)
    steps = steps_before_gap(log)
    previous: Step | None = None
    for number, step in enumerate(steps):
        difference = _step_difference(controller, searches, tolerance, log, previous, step)
        if difference is not None:
            return Recomputed(number, difference)
        previous = step
    if len(steps) < len(log.steps):
        return Recomputed(len(steps), None)
    searches.start_step(())
    return Recomputed(len(steps), _outcome_difference(log, controller, previous))


def _step_difference(
    controller: Controller,
    searches: "StepSearches",
    tolerance: Tolerance,
    log: TrialLog,
    previous: Step | None,
    step: Step,
) -> Difference | None:
    """Repeat the decision of a step, and return the first difference from the logged decision.

    Args:
        controller: The rebuilt controller.
        searches: Answers the controller's searches.
        tolerance: How far numbers may differ.
        log: The log.
        previous: The step before. None for the first step.
        step: The step whose decision is repeated.

    Returns:
        The difference. None if the decisions agree.
    """
    searches.start_step(step.plan.searches)
    try:
        decision = plan_again(controller, log, previous, step.observation)
        searches.require_time()
    except (TooLongError, MemoryError):
        message = (
            "the rest was not computed again, because it would take more than "
            f"{seconds_limit():g} s, or too much memory"
        )
        return Unchecked(
            step.k, "plan", f"{message}; with {FACTOR_VARIABLE}=2, twice as much is allowed"
        )
    except NoSearchError:
        if searches.contradiction is not None:
            return searches.contradiction.in_step(step.k)
        return Difference(step.k, "searches", f"only {len(step.plan.searches)} logged")
    except TetractlError as error:
        return Difference(step.k, "plan", error.message)
    if not isinstance(decision, Plan):
        outcome = _outcome_of(decision)
        return Difference(step.k, "plan", f"the controller ends the trial: {outcome.value}")
    if decision.generator != step.plan.generator:
        message = (
            f"the log contains {step.plan.generator}, but the seed and the index of the trial give "
            f"{decision.generator}"
        )
        return Difference(step.k, "generator", message)
    if searches.contradiction is not None:
        return searches.contradiction.in_step(step.k)
    return _plan_difference(decision, step, tolerance)


def _plan_difference(plan: Plan, step: Step, tolerance: Tolerance) -> Difference | None:
    """Find the first difference between a recomputed plan and the logged plan of a step.

    The logged path is rounded and has no headings: if bits may differ, another number may be
    rounded in the other direction. An earlier version may have logged fewer numbers.
    """
    logged = step.plan
    numbers = {name: value for name, value in plan.numbers.items() if name in logged.numbers}
    same_path = replace(plan, path=logged.path, numbers=numbers)
    difference = first_difference(same_path, logged, tolerance)
    if difference is None:
        if tolerance != SAME_BITS:
            tolerance = replace(tolerance, relative=2 * DRAWING_PRECISION)
        path = round_for_drawing(plan.path[..., :2])
        difference = first_difference(path, logged.path[..., :2], tolerance, "path")
    return None if difference is None else difference.in_step(step.k)


def plan_again(
    controller: Controller, log: TrialLog, previous: Step | None, observation: Observation
) -> Decision:
    """Repeat a controller's decision in the control step after a logged step.

    Args:
        controller: The controller.
        log: The log.
        previous: The previous step. None for the first step.
        observation: The observation of the step.

    Raises:
        PluginTrialError: If a plug-in fails.
    """
    last_command = None
    earlier_frames: list[Observation] = []
    if previous is not None:
        last_command = previous.command
        is_after_previous = log.mocap_ns > previous.observation.sampled_ns
        rows_between = np.flatnonzero(is_after_previous & (log.mocap_ns < observation.sampled_ns))
        earlier_frames = [log.sample(int(row)).observation for row in rows_between]
    with name_plugins_in_errors(find_packages(log.experiment)):
        return controller.plan(observation, last_command, earlier_frames)


def steps_before_gap(log: TrialLog) -> list[Step]:
    """Return the control steps before the first missing step.

    In a damaged log, only the steps before the first missing camera frame are returned.
    """
    lost_count = len(log.damage.lost) if log.damage else 0
    lost_count_without_result = 0 if log.result else 1  # the result and what follows it
    first_missing = np.inf
    if lost_count > lost_count_without_result:
        first_missing = min((gap.first_number for gap in frame_gaps(log)), default=np.inf)
    steps: list[Step] = []
    for number, step in enumerate(log.steps):
        if step.k != number or step.observation.frame >= first_missing:
            break
        steps.append(step)
    return steps


# ---- The end of a trial ----


def _outcome_difference(
    log: TrialLog, controller: Controller, last_step: Step | None
) -> Difference | None:
    """Check that the controller ends the trial with the logged outcome.

    The controller must do so on a camera frame of the last control period. The log does not name
    the frame on which the trial ended, but it is one of `_final_frame_rows`. An abort or an
    interrupt is checked only where the controller may have decided it. Then it is checked only if
    the controller ends the trial on the newest of these frames.
    """
    result = log.result
    if result is None or log.stop is None:
        return None
    if not result.outcome.complete:
        # in the lab a fault may occur at the same time, and a trial whose robots do not come to
        # rest after its end counts as aborted, too
        is_error = any(note.level == "error" and note.text == result.reason for note in log.notes)
        if is_error or not log.start.plant.simulated:
            return None
    decisions: list[_FinalDecision] = []
    for frame in _final_frame_rows(log, last_step, log.stop.sent_ns):
        decision = _decide_again(controller, log, last_step, log.sample(frame).observation)
        if decision.outcome is result.outcome:
            return None
        decisions.append(decision)
    newest = (
        decisions[0] if decisions else _FinalDecision(None, "there is no frame on which to decide")
    )
    if newest.outcome is None and not result.outcome.complete:
        return None
    logged = result.outcome.value
    return Difference(None, "outcome", f"logged {logged!r}, but {newest.description}")


def _final_frame_rows(log: TrialLog, last_step: Step | None, stop_ns: int) -> list[int]:
    """Find the rows of the camera frames on which a trial may have ended, the newest first.

    The trial was stopped at `stop_ns`. In a lab, every frame after the last step is possible,
    because the stop may have been sent later. In a simulation, it is the newest frame one control
    period after the last command.
    """
    since_ns = last_step.observation.received_ns if last_step else -1
    is_after_step = (log.received_ns > since_ns) & (log.received_ns <= stop_ns)
    newest_first = np.flatnonzero(is_after_step)[::-1]
    if log.start.plant.simulated:
        due_ns = stop_ns
        if last_step is not None:
            pause_s = PAUSE_S if last_step.plan.pauses else 0.0
            wait_ns = round((log.experiment.controller.period + pause_s) * SECOND)
            due_ns = last_step.command.sent_ns + wait_ns
        in_time = log.received_ns[newest_first] <= due_ns
        newest_first = newest_first[in_time][:1]
    return newest_first.tolist()


@dataclass(frozen=True, slots=True)
class _FinalDecision:
    """A controller's decision after the last logged step.

    Attributes:
        outcome: The outcome with which the controller ends the trial. None if it does not end it.
        description: The decision in words.
    """

    outcome: Outcome | None
    description: str


def _decide_again(
    controller: Controller, log: TrialLog, last_step: Step | None, observation: Observation
) -> _FinalDecision:
    """Let a copy of the controller decide on a frame after the last logged step.

    The copy has its own copy of the searches, so that each frame counts as the first frame after
    `last_step`. The log has no more searches.
    """
    try:
        decision = plan_again(copy.deepcopy(controller), log, last_step, observation)
    except NoSearchError:
        return _FinalDecision(None, "the controller goes on")
    except TetractlError:
        return _FinalDecision(None, "the controller cannot go on")
    if isinstance(decision, Plan):
        return _FinalDecision(None, "the controller goes on")
    outcome = _outcome_of(decision)
    return _FinalDecision(outcome, f"the controller decides {outcome.value!r}")


def _outcome_of(decision: Outcome | End) -> Outcome:
    """Return the outcome with which a controller ends a trial."""
    return decision.outcome if isinstance(decision, End) else decision


# ---- The searches of a step ----


class TooLongError(Exception):
    """An error: repeating the decisions of a trial would take longer than the limits allow."""


class NoSearchError(Exception):
    """An error: the controller searches at a point where the log contains no search."""


@dataclass(frozen=True, slots=True)
class SearchRequest:
    """A search that a controller requests: the optimiser, and the arguments of its `search`."""

    optimizer: OptimizerSection
    problem: Problem
    length: int
    warm: Floats | None
    key: int
    limits: Limits


class StepSearches:
    """Answers a controller's searches with the logged searches of the present step.

    Call `start_step` before each step. The processor time is limited to `seconds_limit`. If
    searches are run again, the time counts from the first search, which compiles.

    Args:
        search_again: Whether to run the logged searches again. If False, their results are only
            evaluated.
        read_cpu_s: Returns the processor time [s].

    Attributes:
        requests: The controller's requests in this step, by the index of the search in the log.
        contradiction: How the first contradictory logged result contradicts its problem or its
            optimiser. None if no contradiction was found.
    """

    def __init__(self, search_again: bool, read_cpu_s: Callable[[], float] = computing_s) -> None:
        self.requests: dict[int, SearchRequest] = {}
        self.contradiction: Difference | None = None
        self._remaining: list[tuple[int, Search]] = []
        self._search_again = search_again
        self._is_compiled = False
        self._read_cpu_s = read_cpu_s
        self._deadline_s = math.inf if search_again else read_cpu_s() + seconds_limit()

    def controller(self, log: TrialLog, key: int) -> Controller:
        """Rebuild the controller of a log. This object answers the searches of the controller.

        Args:
            log: The log.
            key: Seed of the controller's random numbers.
        """
        host = Host(lambda optimizer: _ReplayOptimizer(optimizer, self), self._time_ns)
        return CheckedController(log.experiment.controller, log.start.setup, key, host)

    def start_step(self, searches: Sequence[Search]) -> None:
        """Start a control step: `search` answers from the logged searches of this step.

        The searches, requests and contradictions of the step before are forgotten. Searches for
        given directions are left out, because given signals need no search.
        """
        self._remaining = [
            (index, search)
            for index, search in enumerate(searches)
            if search.stopped != StopReason.FIXED
        ]
        self.contradiction = None
        self.requests = {}

    def search(self, request: SearchRequest) -> Search:
        """Answer a search that the controller asks for, from the log or by running it again.

        Raises:
            NoSearchError: If the log has no further search in this step.
            TooLongError: If the time limit is exceeded.
        """
        if not self._remaining:
            raise NoSearchError
        index, logged = self._remaining.pop(0)
        self.requests[index] = request
        if self._search_again:
            return self._run_again(request, logged)
        if self.contradiction is None:
            name = f"searches.{index}"
            self.contradiction = next(_contradictions(request, logged, name), None)
        if logged.length != request.length:
            raise NoSearchError
        return logged

    def _run_again(self, request: SearchRequest, logged: Search) -> Search:
        """Run a logged search again.

        If a deadline ended the logged search, the new search ends after the same number of
        evaluations. TooLongError is raised if this exceeds the time limit.
        """
        if not self._is_compiled:
            minimum_limits = Limits(request.optimizer.evaluations_min)
            request.optimizer.search(request.problem, 1, np.zeros(1), request.key, minimum_limits)
            self._is_compiled = True
            self._deadline_s = self._read_cpu_s() + seconds_limit()
        evaluations_max = logged.evaluations if logged.stopped == StopReason.DEADLINE else np.inf
        limits = replace(
            request.limits, expired=lambda spent: self.is_expired() or spent >= evaluations_max
        )
        search = request.optimizer.search(
            request.problem, request.length, request.warm, request.key, limits
        )
        self.require_time()
        return search

    def is_expired(self) -> bool:
        """Check whether the time limit of the verification is exceeded."""
        return self._read_cpu_s() > self._deadline_s

    def require_time(self) -> None:
        """Check that time is left for the verification. TooLongError is raised if not."""
        if self.is_expired():
            raise TooLongError

    def _time_ns(self) -> int:
        """Return the time for the controller's deadline.

        The logged searches ended before the deadline, or the deadline cut them short. Therefore, no
        time passes until the last search has been answered. Then every deadline has passed.
        """
        return 0 if self._remaining else AFTER_EVERY_DEADLINE_NS


@dataclass(frozen=True, slots=True)
class _ReplayOptimizer:
    """An `Optimizer` that lets a `StepSearches` answer its searches."""

    optimizer: OptimizerSection
    searches: StepSearches

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Return the answer to a search; see `Optimizer.search`.

        `warm` is copied, because the controller continues to use it.
        """
        warm_copy = None if warm is None else warm.copy()
        return self.searches.search(
            SearchRequest(self.optimizer, problem, length, warm_copy, key, limits)
        )


def _contradictions(request: SearchRequest, logged: Search, name: str) -> Iterator[Difference]:
    """Yield each way in which a logged search contradicts its problem or its optimiser.

    If the number of signals is wrong, nothing else is checked.
    """
    if logged.length != request.length:
        yield Difference(None, f"{name}.length", f"{logged.length}, not {request.length}")
        return
    problem = request.problem
    cost = float(evaluate(problem, logged.signals[None]).total[0])
    tolerance = _evaluation_tolerance(problem.poses.xy, problem.targets)
    difference = first_difference(cost, logged.cost, tolerance, f"{name}.cost")
    if difference is not None:
        yield difference
    history = logged.history
    if not len(history) or history[-1] != logged.cost or (np.diff(history) > 0).any():
        yield Difference(None, f"{name}.history", "does not decrease to the stated cost")
    for field in _impossible_fields(request, logged):
        message = (
            f"the log contains {getattr(logged, field)}, which contradicts the search's history or "
            "the limits in the spec"
        )
        yield Difference(None, f"{name}.{field}", message)


def _impossible_fields(request: SearchRequest, logged: Search) -> Iterator[str]:
    """Yield the fields of a logged search that its optimiser cannot have produced.

    The history of a swarm fixes the number of evaluations and the reason for its end.
    """
    swarm = request.optimizer
    if not isinstance(swarm, Pso):
        if logged.evaluations < 1:
            yield "evaluations"
    elif len(logged.history):  # a search without a history is reported above
        warm_starts = 0 if request.warm is None else 1
        if logged.evaluations != swarm.particles * len(logged.history) + warm_starts:
            yield "evaluations"
        if logged.stopped not in _possible_ends(swarm, logged.history, request.limits):
            yield "stopped"


def _possible_ends(swarm: Pso, history: Floats, limits: Limits) -> set[StopReason]:
    """Return the possible reasons for the end of a swarm search with this history.

    There is more than one only if a limit cut the search short.
    """
    if len(history) > 1:
        with np.errstate(invalid="ignore"):  # logarithms fail if a logged history rises
            reason = reason_to_stop(history, swarm.stop)
        if reason is not None:
            return {reason}
    if len(history) > swarm.iterations:
        return {StopReason.ITERATIONS}
    cut_short = set[StopReason]()
    if limits.evaluations is not None:
        cut_short.add(StopReason.EVALUATIONS)
    if limits.timed:
        cut_short.add(StopReason.DEADLINE)
    return cut_short


def _evaluation_tolerance(positions: Floats, targets: Floats) -> Tolerance:
    """Compute the tolerance for re-evaluating costs.

    Args:
        positions: Positions of the robots, shape (N, 2) [length unit].
        targets: Targets of the robots, shape (N, 2) [length unit].
    """
    coordinates = np.abs(np.concatenate([positions, targets]))
    largest = float(coordinates.max(initial=1.0))
    return Tolerance(RELATIVE_TOLERANCE, ABSOLUTE_TOLERANCE * largest * len(targets))

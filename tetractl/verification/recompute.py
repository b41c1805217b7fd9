"""Repeat each decision of a logged trial with a controller that is rebuilt from the log.

`recompute` goes through the steps: `_step_difference` lets the controller decide on the logged
frames, and compares. `StepSearches.search` answers the controller's searches in one of two ways.
*Re-computed*: every search is run again and must give the same bits, as it does on the machine and
with the versions that wrote the log. *Re-evaluated*: the searches' results are read from the log;
their J, the choice among them and the predicted path are computed again, and must agree within
TOLERANCE and ROUNDING. Searches cannot be repeated on another processor: a difference in the last
bit of one cost may change the leading particle and then the whole search.
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
from tetractl.core.loggable import DRAWN_PRECISION, drawn
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
from tetractl.log.read.limits import FACTOR, seconds_limit
from tetractl.log.read.trial_log import TrialLog, frame_gaps
from tetractl.run.checked_controller import CheckedController
from tetractl.run.spec_trial import trial_seeds
from tetractl.spec.controller import Host, OptimizerSection
from tetractl.spec.experiment import packages
from tetractl.tools.kernels.kernel_cache import computing_s
from tetractl.tools.plugin_fault import plugins_named
from tetractl.verification.comparison import (
    SAME_BITS,
    Difference,
    Tolerance,
    Unchecked,
    first_difference,
)

TOLERANCE = 1e-9
"""Relative tolerance of re-evaluation."""
ROUNDING = 1e-12
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
        agreeing: Number of steps before the first difference.
        difference: The first difference. None if all agree.
    """

    agreeing: int
    difference: Difference | None


def recompute(
    log: TrialLog, search_again: bool, cpu: Callable[[], float] = computing_s
) -> Recomputed:
    """Compute every decision of a log again, up to the first that differs.

    Steps after a gap are not checked, because the controller's state is lost. If the processor time
    exceeds its limit, the difference is an `Unchecked`. Compiling does not count.

    Args:
        log: The log.
        search_again: Whether to run the searches again and compare bits. If False, the logged
            searches are used.
        cpu: Returns the processor time [s].
    """
    try:
        key, _ = trial_seeds(log.start.seed, log.start.trial)
    except (ValueError, OverflowError):
        text = f"with the seed {log.start.seed}, there is no trial {log.start.trial}"
        return Recomputed(0, Difference(None, "seed", text))
    searches = StepSearches(search_again, cpu)
    controller = searches.controller(log, key)
    setup = log.start.setup
    tolerance = SAME_BITS
    if not search_again:
        tolerance = _tolerance(setup.starts.xy, setup.targets)
    steps = first_steps(log)
    last: Step | None = None
    for number, step in enumerate(steps):
        difference = _step_difference(controller, searches, tolerance, log, last, step)
        if difference is not None:
            return Recomputed(number, difference)
        last = step
    if len(steps) < len(log.steps):
        return Recomputed(len(steps), None)
    searches.begin(())
    return Recomputed(len(steps), _outcome_difference(log, controller, last))


def _step_difference(
    controller: Controller,
    searches: "StepSearches",
    tolerance: Tolerance,
    log: TrialLog,
    last: Step | None,
    step: Step,
) -> Difference | None:
    """Repeat the decision of a step, and return the first difference from the logged decision.

    The step follows `last`. The result is None if there is no difference.
    """
    searches.begin(step.plan.searches)
    try:
        decision = plan_again(controller, log, last, step.observation)
        searches.require_time()
    except (TooLongError, MemoryError):
        text = (
            f"the rest was not computed again, because it takes over {seconds_limit():g} "
            "s or much memory"
        )
        return Unchecked(step.k, "plan", f"{text}; with {FACTOR}=2, twice as much is allowed")
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
        text = f"logged {step.plan.generator}, but seed and trial give {decision.generator}"
        return Difference(step.k, "generator", text)
    if searches.contradiction is not None:
        return searches.contradiction.in_step(step.k)
    return _plan_difference(decision, step, tolerance)


def _plan_difference(plan: Plan, step: Step, tolerance: Tolerance) -> Difference | None:
    """Return the first difference between a plan and the logged one.

    The logged path is rounded and has no headings: if bits may differ, another number may be
    rounded in the other direction. An earlier version may have logged fewer numbers.
    """
    logged = step.plan
    numbers = {name: value for name, value in plan.numbers.items() if name in logged.numbers}
    same_path = replace(plan, path=logged.path, numbers=numbers)
    difference = first_difference(same_path, logged, tolerance)
    if difference is None:
        if tolerance != SAME_BITS:
            tolerance = replace(tolerance, relative=2 * DRAWN_PRECISION)
        path = drawn(plan.path[..., :2])
        difference = first_difference(path, logged.path[..., :2], tolerance, "path")
    return None if difference is None else difference.in_step(step.k)


def plan_again(
    controller: Controller, log: TrialLog, last: Step | None, observation: Observation
) -> Decision:
    """Repeat a controller's decision in the control step after a logged step.

    Args:
        controller: The controller.
        log: The log.
        last: The previous step. None for the first step.
        observation: The observation of the step.

    Raises:
        PluginTrialError: If a plug-in fails.
    """
    command = None
    earlier: list[Observation] = []
    if last is not None:
        command = last.command
        after = log.mocap_ns > last.observation.sampled_ns
        between = np.flatnonzero(after & (log.mocap_ns < observation.sampled_ns))
        earlier = [log.sample(int(row)).observation for row in between]
    with plugins_named(packages(log.experiment)):
        return controller.plan(observation, command, earlier)


def first_steps(log: TrialLog) -> list[Step]:
    """Return the control steps before the first missing step.

    In a damaged log, only the steps before the first missing camera frame are returned.
    """
    lost = len(log.damage.lost) if log.damage else 0
    lost_with_its_end = 0 if log.result else 1  # the result and what follows it
    first_missing = np.inf
    if lost > lost_with_its_end:
        first_missing = min((gap.first for gap in frame_gaps(log)), default=np.inf)
    steps: list[Step] = []
    for number, step in enumerate(log.steps):
        if step.k != number or step.observation.frame >= first_missing:
            break
        steps.append(step)
    return steps


# ---- The end of a trial ----


def _outcome_difference(
    log: TrialLog, controller: Controller, last: Step | None
) -> Difference | None:
    """Check that the controller ends the trial with the logged outcome.

    It must do so on a camera frame of the last control period. The log does not name the frame on
    which the trial ended: it is one of `_last_frames`. An abort or an interrupt is checked only
    where the controller may have decided it, and then only if it ends the trial on the newest of
    these frames.
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
    ends: list[_LastDecision] = []
    for frame in _last_frames(log, last, log.stop.sent_ns):
        end = _decide_last(controller, log, last, log.sample(frame).observation)
        if end.outcome is result.outcome:
            return None
        ends.append(end)
    newest = ends[0] if ends else _LastDecision(None, "there is no frame on which to decide")
    if newest.outcome is None and not result.outcome.complete:
        return None
    logged = result.outcome.value
    return Difference(None, "outcome", f"logged {logged!r}, but {newest.text}")


def _last_frames(log: TrialLog, last: Step | None, stop_ns: int) -> list[int]:
    """Return the rows of the camera frames on which a trial may have ended, the newest first.

    The trial was stopped at `stop_ns`. In a lab, every frame after the last step is possible,
    because the stop may have been sent later. In a simulation, it is the newest frame one control
    period after the last command.
    """
    since_ns = last.observation.received_ns if last else -1
    after = (log.received_ns > since_ns) & (log.received_ns <= stop_ns)
    newest_first = np.flatnonzero(after)[::-1]
    if log.start.plant.simulated:
        due_ns = stop_ns
        if last is not None:
            pause_s = PAUSE_S if last.plan.pauses else 0.0
            wait_ns = round((log.experiment.controller.period + pause_s) * SECOND)
            due_ns = last.command.sent_ns + wait_ns
        in_time = log.received_ns[newest_first] <= due_ns
        newest_first = newest_first[in_time][:1]
    return newest_first.tolist()


@dataclass(frozen=True, slots=True)
class _LastDecision:
    """The outcome with which a controller ends a trial, and its description in words.

    The outcome is None if the controller does not end the trial.
    """

    outcome: Outcome | None
    text: str


def _decide_last(
    controller: Controller, log: TrialLog, last: Step | None, observation: Observation
) -> _LastDecision:
    """Return the decision of a controller for which the log has no more searches.

    A copy decides, with a copy of its searches, so that each frame is the first after `last`.
    """
    try:
        decision = plan_again(copy.deepcopy(controller), log, last, observation)
    except NoSearchError:
        return _LastDecision(None, "the controller goes on")
    except TetractlError:
        return _LastDecision(None, "the controller cannot go on")
    if isinstance(decision, Plan):
        return _LastDecision(None, "the controller goes on")
    outcome = _outcome_of(decision)
    return _LastDecision(outcome, f"the controller decides {outcome.value!r}")


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

    They are run again if `search_again` is True. Otherwise, their results are evaluated. Call
    `begin` before each step. Then `requests` contains the controller's requests in this step, by
    the index of the search in the log. `contradiction` describes how the first logged result
    contradicts its problem or its optimiser. The processor time, read from `cpu` [s], is limited to
    `seconds_limit`. For searches that are run again, it counts from the first search, which
    compiles.
    """

    def __init__(self, search_again: bool, cpu: Callable[[], float] = computing_s) -> None:
        self.requests: dict[int, SearchRequest] = {}
        self.contradiction: Difference | None = None
        self._to_come: list[tuple[int, Search]] = []
        self._search_again = search_again
        self._is_compiled = False
        self._cpu = cpu
        self._until_s = math.inf if search_again else cpu() + seconds_limit()

    def controller(self, log: TrialLog, key: int) -> Controller:
        """Rebuild the controller of a log, with the random key `key`.

        Its searches are answered by this object.
        """
        host = Host(lambda optimizer: _Repeated(optimizer, self), self._time_ns)
        return CheckedController(log.experiment.controller, log.start.setup, key, host)

    def begin(self, searches: Sequence[Search]) -> None:
        """Take the logged searches of another control step, from which `search` answers.

        The earlier step is forgotten. Searches for given directions are left out, because given
        signals need no search. No contradiction has been found and nothing has been requested yet.
        """
        self._to_come = [
            (index, search)
            for index, search in enumerate(searches)
            if search.stopped != StopReason.FIXED
        ]
        self.contradiction = None
        self.requests = {}

    def search(self, request: SearchRequest) -> Search:
        """Answer a search that the controller asks for, from the log or by running it again.

        Raises:
            NoSearchError: If the log has no other search.
            TooLongError: If the time limit is exceeded.
        """
        if not self._to_come:
            raise NoSearchError
        index, logged = self._to_come.pop(0)
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

        If the deadline ended it, it is ended after its logged number of evaluations. TooLongError
        is raised if this exceeds the time limit.
        """
        if not self._is_compiled:
            least = Limits(request.optimizer.evaluations_min)
            request.optimizer.search(request.problem, 1, np.zeros(1), request.key, least)
            self._is_compiled = True
            self._until_s = self._cpu() + seconds_limit()
        most = logged.evaluations if logged.stopped == StopReason.DEADLINE else np.inf
        limited = replace(request.limits, expired=lambda spent: self.expired() or spent >= most)
        search = request.optimizer.search(
            request.problem, request.length, request.warm, request.key, limited
        )
        self.require_time()
        return search

    def expired(self) -> bool:
        """Check whether the time limit of the verification is exceeded."""
        return self._cpu() > self._until_s

    def require_time(self) -> None:
        """Check that time is left for the verification. TooLongError is raised if not."""
        if self.expired():
            raise TooLongError

    def _time_ns(self) -> int:
        """Return the time for the controller's deadline.

        The searches were logged before the deadline or cut short by it. Therefore no time passes
        until the last of them, and then every deadline has passed.
        """
        return 0 if self._to_come else AFTER_EVERY_DEADLINE_NS


@dataclass(frozen=True, slots=True)
class _Repeated:
    """An `Optimizer` that passes its searches to `searches`, which answers them."""

    optimizer: OptimizerSection
    searches: StepSearches

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Return the answer to a search; see `Optimizer.search`.

        `warm` is copied, because the controller continues to use it.
        """
        start = None if warm is None else warm.copy()
        return self.searches.search(
            SearchRequest(self.optimizer, problem, length, start, key, limits)
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
    tolerance = _tolerance(problem.poses.xy, problem.targets)
    difference = first_difference(cost, logged.cost, tolerance, f"{name}.cost")
    if difference is not None:
        yield difference
    history = logged.history
    if not len(history) or history[-1] != logged.cost or (np.diff(history) > 0).any():
        yield Difference(None, f"{name}.history", "does not decrease to the stated cost")
    for field in _impossible_fields(request, logged):
        text = (
            f"logged {getattr(logged, field)}, which contradicts its history and the spec's limits"
        )
        yield Difference(None, f"{name}.{field}", text)


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


def _tolerance(xy: Floats, targets: Floats) -> Tolerance:
    """Return the tolerance of re-evaluation for N robots at `xy` (N, 2) with `targets` (N, 2)."""
    ends = np.abs(np.concatenate([xy, targets]))
    largest = float(ends.max(initial=1.0))
    return Tolerance(TOLERANCE, ROUNDING * largest * len(targets))

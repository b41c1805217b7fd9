"""Computes each decision of a trial again with the controller rebuilt from the log.

There are two methods. *Re-computed*: every search is run again and must give the same bits, as it
does on the machine and with the versions that wrote the log. *Re-evaluated*: the searches' results
are read from the log; their J, the choice among them and the predicted path are computed again, and
must agree within TOLERANCE and ROUNDING. Searches cannot be repeated on another processor: a
difference in the last bit of one cost may change the leading particle and then the whole search.
"""

import copy
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tetractl.control.cost import evaluate
from tetractl.core.clock import SECOND
from tetractl.core.errors import TetractlError
from tetractl.core.plan import (
    PAUSE_S,
    End,
    Limits,
    Outcome,
    Plan,
    Problem,
    Search,
    StopReason,
)
from tetractl.core.poses import Floats, Observation
from tetractl.core.protocols import Controller, Optimizer
from tetractl.core.trial import Result, Step
from tetractl.experiment.controller import Host, OptimizerSection
from tetractl.log.read import limits
from tetractl.log.read.trial_log import TrialLog, frame_gaps
from tetractl.replay.difference import EXACT, Difference, Tolerance, first_difference
from tetractl.run.task import trial_seeds

TOLERANCE = 1e-9
"""Relative tolerance of re-evaluation."""
ROUNDING = 1e-12
"""Additional tolerance relative to the largest coordinate: a cost near 0 is a small difference of
much larger coordinates."""

_LONG_AGO = 2**62


class NoSearchError(Exception):
    """The controller searches at a point where the log has no search."""


class _TooLongError(Exception):
    """Computing the decisions again would take longer than the limits allow."""


class Rerun:
    """Repeats the logged searches of a trial, in place of a controller's optimisers.

    A search that was ended by the deadline is repeated with a deadline that passes once the logged
    number of evaluations is done. With `search_again` False, nothing is searched: the logged
    searches are returned, and contradictions are added to `wrong`. `limit_s` is the processor time
    allowed after `start`, and `cpu` the clock that measures it [s].
    """

    def __init__(self, search_again: bool, cpu: Callable[[], float], limit_s: float) -> None:
        self.search_again = search_again
        self._cpu, self._limit_s = cpu, limit_s
        self._until: float | None = None
        self.wrong: list[tuple[str, str]] = []
        self._left: list[tuple[int, Search]] = []

    @property
    def started(self) -> bool:
        """Whether `start` was called."""
        return self._until is not None

    def start(self) -> None:
        """Start the time limit."""
        self._until = self._cpu() + self._limit_s

    def expired(self) -> bool:
        """Return whether the time limit is exceeded."""
        return self._until is not None and self._cpu() > self._until

    def begin(self, searches: Sequence[Search]) -> None:
        """Continue with the logged searches of a step; given signals need no search."""
        found = [(i, one) for i, one in enumerate(searches) if one.stopped != StopReason.FIXED]
        self._left, self.wrong = found, []

    def timer(self) -> int:
        """Return the time [ns] for the controller's deadline: 0 while logged searches are left,
        then a time after every deadline.
        """
        return 0 if self._left else _LONG_AGO

    def wrap(self, optimizer: OptimizerSection) -> Optimizer:
        """Return an optimiser that repeats the logged searches with `optimizer`."""
        return _Repeated(optimizer, self)

    def next(self) -> tuple[int, Search]:
        """Return the index of the next logged search in its step, and the search."""
        if not self._left:
            raise NoSearchError
        return self._left.pop(0)


class _Repeated:
    """An `Optimizer` for verification, which repeats or returns the logged searches."""

    def __init__(self, optimizer: OptimizerSection, rerun: Rerun) -> None:
        self._optimizer, self._rerun = optimizer, rerun

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Run the next logged search again, or return it."""
        index, logged = self._rerun.next()
        if not self._rerun.search_again:
            self._evaluate(problem, length, warm is not None, limits, index, logged)
            return logged

        def found_with(most: float) -> Search:
            late = self._rerun.expired
            limited = replace(limits, expired=lambda spent: late() or spent >= most)
            found = self._optimizer.search(problem, length, warm, key, limited)
            if late():
                raise _TooLongError
            return found

        _require_affordable(self._optimizer, problem, length)
        if not self._rerun.started:  # the time of compiling does not count
            least = Limits(self._optimizer.evaluations_min)
            self._optimizer.search(problem, 1, np.zeros(1), key, least)
            self._rerun.start()
        return found_with(logged.evaluations if logged.stopped == StopReason.DEADLINE else np.inf)

    def _evaluate(
        self,
        problem: Problem,
        length: int,
        warmed: bool,
        limits: Limits,
        index: int,
        logged: Search,
    ) -> None:
        """Add to `Rerun.wrong` how a logged search contradicts its problem or its optimiser."""
        name, wrong = f"searches.{index}", self._rerun.wrong
        if logged.length != length or len(logged.signals) != length:
            wrong.append((f"{name}.length", f"{logged.length}, not {length}"))
            raise NoSearchError
        cost = float(evaluate(problem, logged.signals[None]).total[0])
        tolerance = _tolerance(problem.poses.xy, problem.targets)
        wrong += filter(None, [first_difference(cost, logged.cost, tolerance, f"{name}.cost")])
        history = logged.history
        if not len(history) or history[-1] != logged.cost or (np.diff(history) > 0).any():
            wrong.append((f"{name}.history", "does not decrease to the stated cost"))
        for field in self._optimizer.contradictions(logged, warmed, limits):
            value = getattr(logged, field)
            text = f"logged {value}, which contradicts its history and the spec's limits"
            wrong.append((f"{name}.{field}", text))


def _require_affordable(optimizer: OptimizerSection, problem: Problem, length: int) -> None:
    """Raise _TooLongError if one round of a search is larger than the limit for searches of
    logs.
    """
    robots, obstacles = problem.a.size, problem.obstacles.count
    if optimizer.evaluations_min * length * robots * (1 + obstacles) > limits.swarm_limit():
        raise _TooLongError


def recompute(
    log: TrialLog, search_again: bool, cpu: Callable[[], float] = time.thread_time
) -> Difference | None:
    """Compute every decision of a log again; return the first difference or None.

    `search_again` True runs the searches again and compares bits, False uses the logged searches.
    Steps after a gap are not checked, since the controller's state is lost. If the processor time,
    read from `cpu` [s], exceeds its limit, a difference that says so is returned.
    """
    try:
        key, _ = trial_seeds(log.start.seed, log.start.trial)
    except (ValueError, OverflowError):
        return Difference(None, "seed", f"seed {log.start.seed} has no trial {log.start.trial}")
    setup, limit_s = log.start.setup, limits.seconds_limit()
    rerun = Rerun(search_again, cpu, limit_s)
    if not search_again:
        rerun.start()
    controller = log.experiment.controller.build(setup, key, Host(rerun.wrap, rerun.timer))
    tolerance = EXACT if search_again else _tolerance(setup.starts.xy, setup.targets)
    last: Step | None = None
    for step in first_steps(log):
        rerun.begin(step.plan.searches)
        try:
            decision = plan_again(controller, log, last, step.observation)
            if rerun.expired():
                raise _TooLongError
        except (_TooLongError, MemoryError):
            text = f"not computed again: the rest takes over {limit_s:g} s or much memory"
            return Difference(step.k, "plan", f"{text}; {limits.FACTOR}=2 allows twice as much")
        except NoSearchError:
            found = next(iter(rerun.wrong), ("searches", f"only {len(step.plan.searches)} logged"))
            return Difference(step.k, *found)
        except TetractlError as error:
            return Difference(step.k, "plan", str(error))
        if not isinstance(decision, Plan):
            return Difference(
                step.k, "plan", f"the controller ends the trial: {_outcome_text(decision)}"
            )
        if decision.generator != step.plan.generator:
            text = f"logged {step.plan.generator}, but seed and trial give {decision.generator}"
            return Difference(step.k, "generator", text)
        if step.plan.estimate is None and log.damage:  # lost
            decision = replace(decision, estimate=None)
        found = next(iter(rerun.wrong), first_difference(decision, step.plan, tolerance))
        if found:
            return Difference(step.k, *found)
        last = step
    if len(first_steps(log)) < len(log.steps):
        return None
    return _outcome(log, controller, last, rerun)


def plan_again(
    controller: Controller, log: TrialLog, last: Step | None, observation: Observation
) -> Plan | Outcome | End:
    """Return a controller's decision on an observation that follows the control step `last` of a
    log, or on the first observation if `last` is None.
    """
    if last is None:
        return controller.plan(observation)
    began, times = last.observation.sampled_ns, log.mocap_ns
    between = np.flatnonzero((times > began) & (times < observation.sampled_ns))
    earlier = [log.sample(int(i)).observation for i in between]
    return controller.plan(observation, last.command, earlier)


def first_steps(log: TrialLog) -> list[Step]:
    """Return the control steps before the first missing step or, in a damaged log, before the first
    missing camera frame.
    """
    lost = log.damage.lost if log.damage else ()
    torn = len(lost) > (log.result is None)  # not only the end of the log is lost
    gap = min((gap.first for gap in frame_gaps(log)), default=np.inf) if torn else np.inf
    return [
        step for k, step in enumerate(log.steps) if step.k == k and step.observation.frame < gap
    ]


def _outcome(
    log: TrialLog, controller: Controller, last: Step | None, rerun: Rerun
) -> Difference | None:
    """Check that the controller, on a camera frame of the last control period, ends the trial with
    the logged outcome.

    The log does not name the frame on which the trial ended: in a simulation it is the newest frame
    one control period after the last command, in the lab one of the newest. The stop may have been
    sent later.
    """
    result, stop = log.result, log.stop
    if result is None or stop is None:
        return None
    if not result.outcome.complete and not _stopped_by_itself(log, result):
        return None
    since = log.steps[-1].observation.received_ns if log.steps else -1
    period = round(log.experiment.controller.period * SECOND)
    newest = np.flatnonzero((log.received_ns > since) & (log.received_ns <= stop.sent_ns))[::-1]
    if log.start.plant.simulated:
        if last is not None and last.plan.pauses:
            period += round(PAUSE_S * SECOND)
        due = log.steps[-1].command.sent_ns + period if log.steps else stop.sent_ns
        newest = newest[log.received_ns[newest] <= due][:1]
    said: list[str] = []
    rerun.begin(())
    for i in newest:
        try:
            seen = log.sample(int(i)).observation
            decision = plan_again(copy.deepcopy(controller), log, last, seen)
        except NoSearchError:
            said.append("goes on")
            continue
        except TetractlError:
            said.append("cannot go on")
            continue
        outcome = decision.outcome if isinstance(decision, End) else decision
        if outcome is result.outcome:
            return None
        said.append("goes on" if isinstance(decision, Plan) else _outcome_text(decision))
    if not result.outcome.complete and (not said or said[0] in ("goes on", "cannot go on")):
        return None
    why = f"the controller decides {said[0]!r}" if said else "there is no frame to decide on"
    return Difference(None, "outcome", f"logged {result.outcome.value!r}, but {why}")


def _outcome_text(decision: Outcome | End) -> str:
    return (decision.outcome if isinstance(decision, End) else decision).value


def _stopped_by_itself(log: TrialLog, result: Result) -> bool:
    """Return whether the controller may have ended a trial that is logged as aborted or
    interrupted, so that its last decision can be checked. False in the lab: a fault may occur at
    the same time, and a trial also counts as aborted if the robots did not come to rest after its
    end.
    """
    told = any(note.level == "error" and note.text == result.reason for note in log.notes)
    return log.start.plant.simulated and not told


def _tolerance(xy: Floats, targets: Floats) -> Tolerance:
    """Return the tolerance of re-evaluation for N robots at `xy` (N, 2) with `targets` (N, 2)."""
    ends = np.abs(np.concatenate([xy, targets]))
    return Tolerance(TOLERANCE, ROUNDING * float(ends.max(initial=1.0)) * len(targets))

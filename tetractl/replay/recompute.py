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
from dataclasses import dataclass, replace

import numpy as np

from tetractl.control.cost import evaluate
from tetractl.core.clock import SECOND
from tetractl.core.errors import TetractlError
from tetractl.core.plan import PAUSE_S, End, Limits, Outcome, Plan, Problem, Search, StopReason
from tetractl.core.plugin_fault import plugins_blamed
from tetractl.core.poses import Floats, Observation
from tetractl.core.protocols import Controller
from tetractl.core.trial import Result, Step
from tetractl.experiment.controller import Host, OptimizerSection
from tetractl.log.format.codec import DRAWN_PRECISION, drawn
from tetractl.log.read import limits
from tetractl.log.read.trial_log import TrialLog, frame_gaps
from tetractl.replay.comparison import (
    SAME_BITS,
    Difference,
    Tolerance,
    TooLongError,
    first_difference,
)
from tetractl.run.checked_controller import CheckedController
from tetractl.run.task import trial_seeds

TOLERANCE = 1e-9
"""Relative tolerance of re-evaluation."""
ROUNDING = 1e-12
"""Additional tolerance relative to the largest coordinate: a cost near 0 is a small difference of
much larger coordinates."""

GOES_ON = "goes on"


class NoSearchError(Exception):
    """The controller searches at a point where the log has no search."""


@dataclass(frozen=True, slots=True)
class Asked:
    """An optimiser, and what a controller asked of it: the arguments of `Optimizer.search`."""

    optimizer: OptimizerSection
    problem: Problem
    length: int
    warm: Floats | None
    key: int
    limits: Limits


class Rerun:
    """Repeats the logged searches of a trial, in place of a controller's optimisers.

    A search that was ended by the deadline is repeated with a deadline that passes once the logged
    number of evaluations is done. With `search_again` False, nothing is searched: the logged
    searches are returned, and contradictions are added to `wrong`. `asked` are the present step's
    searches by their index in the log. Searches may take `limits.seconds_limit` of processor time,
    read from `cpu` [s]; the time of compiling does not count.
    """

    def __init__(self, search_again: bool, cpu: Callable[[], float] = time.thread_time) -> None:
        self._search_again = search_again
        self._cpu = cpu
        self._compiled = not search_again  # searches are compiled by the first one
        self._until_s = cpu() + limits.seconds_limit()  # of processor time, once compiled
        self.wrong: list[tuple[str, str]] = []
        self.asked: dict[int, Asked] = {}
        self._left: list[tuple[int, Search]] = []

    def controller(self, log: TrialLog, key: int) -> Controller:
        """Return the controller of a log, with the logged searches and the random key `key`."""
        host = Host(lambda optimizer: _Repeated(optimizer, self), self._timer)
        return CheckedController(log.experiment.controller, log.start.setup, key, host)

    def expired(self) -> bool:
        """Return whether the time limit is exceeded."""
        return self._compiled and self._cpu() > self._until_s

    def begin(self, searches: Sequence[Search]) -> None:
        """Continue with the logged searches of a step; given signals need no search."""
        self._left = [
            (i, search) for i, search in enumerate(searches) if search.stopped != StopReason.FIXED
        ]
        self.wrong = []
        self.asked = {}

    def _timer(self) -> int:
        """Return the time [ns] for the controller's deadline: 0 while logged searches are left,
        then a time after every deadline.
        """
        return 0 if self._left else 1 << 62

    def search(self, asked: Asked) -> Search:
        """Run the next logged search again, or return it; TooLongError beyond the limits."""
        if not self._left:
            raise NoSearchError
        index, logged = self._left.pop(0)
        self.asked[index] = asked
        if not self._search_again:
            self._evaluate(asked, f"searches.{index}", logged)
            return logged
        if not self._compiled:
            self._compile(asked)
        most = logged.evaluations if logged.stopped == StopReason.DEADLINE else np.inf
        limited = replace(asked.limits, expired=lambda spent: self.expired() or spent >= most)
        search = asked.optimizer.search(asked.problem, asked.length, asked.warm, asked.key, limited)
        if self.expired():
            raise TooLongError
        return search

    def _compile(self, asked: Asked) -> None:
        """Compile an optimiser by its shortest search; the time limit begins after it."""
        least = Limits(asked.optimizer.evaluations_min)
        asked.optimizer.search(asked.problem, 1, np.zeros(1), asked.key, least)
        self._compiled = True
        self._until_s = self._cpu() + limits.seconds_limit()

    def _evaluate(self, asked: Asked, name: str, logged: Search) -> None:
        """Add to `wrong` how a logged search contradicts its problem or its optimiser."""
        problem, length, wrong = asked.problem, asked.length, self.wrong
        if logged.length != length or len(logged.signals) != length:
            wrong.append((f"{name}.length", f"{logged.length}, not {length}"))
            raise NoSearchError
        cost = float(evaluate(problem, logged.signals[None]).total[0])
        tolerance = _tolerance(problem.poses.xy, problem.targets)
        wrong += filter(None, [first_difference(cost, logged.cost, tolerance, f"{name}.cost")])
        history = logged.history
        if not len(history) or history[-1] != logged.cost or (np.diff(history) > 0).any():
            wrong.append((f"{name}.history", "does not decrease to the stated cost"))
        warmed = asked.warm is not None
        for field in asked.optimizer.contradictions(logged, warmed, asked.limits):
            value = getattr(logged, field)
            text = f"logged {value}, which contradicts its history and the spec's limits"
            wrong.append((f"{name}.{field}", text))


@dataclass(frozen=True, slots=True)
class _Repeated:
    """An `Optimizer` for verification, whose searches `rerun` repeats."""

    optimizer: OptimizerSection
    rerun: Rerun

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Run the next logged search again, or return it."""
        kept = None if warm is None else warm.copy()
        return self.rerun.search(Asked(self.optimizer, problem, length, kept, key, limits))


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
    setup, rerun = log.start.setup, Rerun(search_again, cpu)
    controller = rerun.controller(log, key)
    tolerance = of_path = SAME_BITS
    if not search_again:
        tolerance = _tolerance(setup.starts.xy, setup.targets)
        of_path = replace(tolerance, relative=2 * DRAWN_PRECISION)
    last: Step | None = None
    for step in first_steps(log):
        rerun.begin(step.plan.searches)
        try:
            decision = plan_again(controller, log, last, step.observation)
            if rerun.expired():
                raise TooLongError
        except (TooLongError, MemoryError):
            limit_s = f"{limits.seconds_limit():g} s"
            text = f"not computed again: the rest takes over {limit_s} or much memory"
            return Difference(step.k, "plan", f"{text}; {limits.FACTOR}=2 allows twice as much")
        except NoSearchError:
            found = next(iter(rerun.wrong), ("searches", f"only {len(step.plan.searches)} logged"))
            return Difference(step.k, *found)
        except TetractlError as error:
            return Difference(step.k, "plan", error.message)
        if not isinstance(decision, Plan):
            return Difference(step.k, "plan", f"the controller ends the trial: {_named(decision)}")
        if decision.generator != step.plan.generator:
            text = f"logged {step.plan.generator}, but seed and trial give {decision.generator}"
            return Difference(step.k, "generator", text)
        path, decision = drawn(decision.path[..., :2]), replace(decision, path=step.plan.path)
        found = (
            next(iter(rerun.wrong), None)
            or first_difference(decision, step.plan, tolerance)
            or first_difference(path, step.plan.path[..., :2], of_path, "path")
        )
        if found:
            return Difference(step.k, *found)
        last = step
    if len(first_steps(log)) < len(log.steps):
        return None
    rerun.begin(())
    return _outcome(log, controller, last)


def plan_again(
    controller: Controller, log: TrialLog, last: Step | None, observation: Observation
) -> Plan | Outcome | End:
    """Return a controller's decision on an observation that follows the control step `last` of a
    log, or on the first observation if `last` is None. FaultyPluginError if a plug-in fails.
    """
    command, earlier = None, []
    if last is not None:
        began, times = last.observation.sampled_ns, log.mocap_ns
        between = np.flatnonzero((times > began) & (times < observation.sampled_ns))
        command, earlier = last.command, [log.sample(int(i)).observation for i in between]
    with plugins_blamed():
        return controller.plan(observation, command, earlier)


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


def _outcome(log: TrialLog, controller: Controller, last: Step | None) -> Difference | None:
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
    since = last.observation.received_ns if last else -1
    newest = np.flatnonzero((log.received_ns > since) & (log.received_ns <= stop.sent_ns))[::-1]
    if log.start.plant.simulated:
        pause_s = PAUSE_S if last and last.plan.pauses else 0.0
        wait_ns = round((log.experiment.controller.period + pause_s) * SECOND)
        due = last.command.sent_ns + wait_ns if last else stop.sent_ns
        newest = newest[log.received_ns[newest] <= due][:1]
    said: list[str] = []
    for i in newest:
        try:
            seen = log.sample(int(i)).observation
            said.append(_named(plan_again(copy.deepcopy(controller), log, last, seen)))
        except NoSearchError:
            said.append(GOES_ON)
        except TetractlError:
            said.append("cannot go on")
        if said[-1] == result.outcome.value:
            return None
    if not result.outcome.complete and (not said or said[0] in (GOES_ON, "cannot go on")):
        return None
    why = f"the controller decides {said[0]!r}" if said else "there is no frame to decide on"
    return Difference(None, "outcome", f"logged {result.outcome.value!r}, but {why}")


def _named(decision: Plan | Outcome | End) -> str:
    """Return the outcome that a controller decides, GOES_ON for a plan."""
    if isinstance(decision, Plan):
        return GOES_ON
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

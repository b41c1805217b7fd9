"""The recommended controller: model predictive control in which one value decides.

A *signal* is the direction that all robots follow for a signal period, a *plan* a sequence of
signals. A plan is *under way* while robots follow it; the signals of it that are left are `warm`.
Without one robots are *at rest*: before the first plan, after a rest or a turn on the spot, and
when a leg begins. A *leg* is the part of a trial up to a way-point or to the targets, or the hold
after them.

In each control step the proposers of one of two lists are asked in turn, and the first answer is
what the robots do. What they compare is a value, a predicted error [length unit], the less the
better, of `tetractl.control.value`.

    under way                                        at rest

    pass     go on through a passage                 stay     in a hold: all are within its radius
    stop     in the coming period, if no plan can    finish   if no plan can be worth an attempt,
             be worth more                                    or none fits into the time left
    (plans are searched)                             (plans are searched)
    go on    by the safe plan of least value         turn     on the spot, if none found is safe:
    rest     if a plan from rest can be worth more,           other headings allow other plans
             or no plan found is safe                give up  if none is safe after all turns
                                                     drive    by the plan of least value

What robots do then is the `state` of the plan. docs/reference/controllers/mpc.md draws the states.
As in Algorithm 2 of the paper, plans of several lengths are searched, each from what is left of the
plan under way, and only the first signal is exerted.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tetractl.control.corners import NOT_TURNING, Turning, next_facing
from tetractl.control.cost import Foreseen
from tetractl.control.estimator import StateEstimator
from tetractl.control.evaluate import compiled_foresee
from tetractl.control.fixed_sequence import best_stop, given_search, least_error, make_plan
from tetractl.control.holding import CircleSearch
from tetractl.control.lengths import Searcher, least_length, longer
from tetractl.control.margins import Margins
from tetractl.control.mpc_section import RecommendedMpc
from tetractl.control.passage import AHEAD, MISS_MAX, MISS_OF_WAY, TRUSTED_S, ahead, ways
from tetractl.control.rng import mix
from tetractl.control.standings import Standings
from tetractl.control.trial_time import TrialTime
from tetractl.control.value import Worth
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, Stop, Turn
from tetractl.core.errors import ControlError
from tetractl.core.plan import (
    PAUSE_S,
    End,
    Estimate,
    Limits,
    Outcome,
    Plan,
    Problem,
    Search,
    State,
)
from tetractl.core.poses import Bools, Floats, Observation, Poses
from tetractl.core.setup import Setup
from tetractl.core.shape import Shape
from tetractl.core.tour import told_dead
from tetractl.experiment.controller import Host, Square
from tetractl.experiment.lab_section import REACTION_S

RESTED_S = 2.0
"""Least time that a plan is driven before a rest for a better one [s]: with an optimiser that finds
only poor plans robots would rest after each step."""
SEARCH_S = 1.0  # time after which the searches of a step end for standing robots [s]
LATE = 2.0  # a stop acts after at most this many dead times: it may be lost once
SILENT_NEXT = 2
"""Number of next signals of the plan under way after which robots that receive nothing must keep
clear. Later ones are searched again before they are sent."""
SILENT_LAST = 2  # number of last signals of any plan after which this is not asked
SILENT_ROOM = 0.2  # clearance while robots receive nothing, as a fraction of their radius
PASSED = (Outcome.ARRIVED, Outcome.SEQUENCE_COMPLETED, Outcome.NO_BETTER_PLAN)
"""Outcomes after which the next leg begins."""

Decision = Plan | Outcome | End
"""What robots do in a step, or how a leg ends."""


@dataclass(frozen=True, slots=True)
class Leg:
    """A part of a trial: up to way-point `index` or to the targets, or the hold after them.

    `began_s` is the time of the trial [s] and `began_ns` that of the clock [ns] at its beginning,
    when the robots were `moving` or not; `outcome` is how the leg before ended.
    """

    index: int
    began_s: float
    began_ns: int
    moving: bool
    outcome: Outcome


@dataclass(frozen=True, slots=True)
class Course:
    """Where robots go in a leg: `present` (N,) tells which are not lost, and `targets` (M, 2) are
    those of these M robots; `margins` are the distances that they keep to everything."""

    present: Bools
    targets: Floats
    margins: Margins


@dataclass(frozen=True, slots=True)
class TrialProgress:
    """What the controller keeps from step to step.

    `k` is the number of the step, `last` the plan of the step before, None if the leg begins,
    `began` the step in which the plan under way began, or from which one may begin.
    """

    leg: Leg
    k: int = 0
    last: Plan | None = None
    began: int = 0
    turning: Turning = NOT_TURNING

    @property
    def state(self) -> State:
        """What the robots were commanded to do in this leg; they rest before the first step."""
        return State.RESTING if self.last is None else self.last.state

    @property
    def moving(self) -> bool:
        """Whether the robots drive when the step begins."""
        return self.leg.moving if self.last is None else not self.last.pauses

    @property
    def under_way(self) -> bool:
        """Whether a plan of this leg is under way."""
        return self.last is not None and not self.last.pauses

    def after(self, plan: Plan) -> "TrialProgress":
        """Return the progress after a step in which `plan` was decided."""
        began = self.began if self.under_way else self.k
        turning = self.turning.then(plan.facing)
        return replace(self, k=self.k + 1, last=plan, began=began, turning=turning)


@dataclass(frozen=True, slots=True)
class ControlStep:
    """What a step begins with.

    The `problem` is how robots stand and move, to their targets; `warm` (L,) are the signals left
    of the plan under way, None if none is; `horizon_max` is the longest plan and `signals_left` the
    time until the limit, both in signals; `value` is how plans are valued.
    """

    problem: Problem
    warm: Floats | None
    horizon_max: int
    signals_left: float
    value: Worth

    @property
    def signals_max(self) -> int:
        """The most signals of a plan that ends before the limit of time."""
        return min(self.horizon_max, int(self.signals_left))

    def is_new(self, signals: Floats) -> bool:
        """Return whether signals (L,) are longer than the plan under way and one signal more."""
        return self.warm is None or len(signals) > len(self.warm) + 1

    def allows(self, length: int, wait_s: float) -> bool:
        """Return whether there is time for a plan of `length` signals that begins in `wait_s`;
        if the targets are farther away than the longest plan leads, for the longest plan."""
        left = self.signals_left - wait_s / self.problem.period
        return min(length, self.horizon_max) <= left


class LengthBounds(NamedTuple):
    """The least values of what robots can do instead of a stop: to go on, by the plan under way or
    by a new one, and to rest for a new plan; inf for what they cannot do."""

    go_on: float
    rest: float


class Candidate(NamedTuple):
    """A plan found: its value, the number of its search and its prediction."""

    value: float
    number: int
    seen: Foreseen


class Searched(NamedTuple):
    """What the searches of a step found: all of them in order, and the `candidates`, that of least
    value first. They are plans for the `problem`; `passes` tells whether a tree led to the best."""

    problem: Problem
    searches: Sequence[Search]
    candidates: Sequence[Candidate]
    passes: bool = False


class Mpc:
    """The controller of one trial.

    `plan` is called once a control step. Between two steps it keeps the `progress` of the trial,
    the `course` of the leg, and what `estimator`, `time` and `standings` have counted. `key` seeds
    all random numbers; `timer()`, the time [ns], is read for deadlines alone.
    """

    def __init__(self, section: RecommendedMpc, setup: Setup, key: int, host: Host) -> None:
        self.section = section
        self.setup = setup
        self.key = key
        self.timer = host.timer
        self.optimizer = host.wrap(section.optimizer)
        self.circler = host.wrap(CircleSearch())
        square = isinstance(section.first_plan, Square)
        self.estimator = StateEstimator(
            section.problem(setup), section.period, section.known(setup), square, setup.loss
        )
        self.stands = section.collision.stop_before_collision
        self.time = TrialTime(section.time_limit, section.period)
        self.standings = Standings(setup.names)
        self.legs = setup.legs
        self.progress = TrialProgress(Leg(0, 0.0, 0, False, Outcome.ARRIVED))
        self.course = self._course(0, setup.starts)

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Plan | Outcome | End:
        """Decide what the robots do in one step, or end the trial."""
        self.time.seen(observation, last_command)
        motion = self.estimator.seen(observation, last_command, earlier)
        self.standings.see(self.estimator.estimate)
        dead = self.estimator.losses.dead
        if dead.any() and self.setup.loss and self.setup.loss.ends:
            raise ControlError(told_dead(self.setup.names, dead))
        if self.estimator.left is not self.course.present:  # robots were lost
            self._begin(replace(self.progress.leg, moving=self.progress.moving), observation.poses)
        decision = self._decide(motion, observation)
        while self._ends_a_leg_only(decision):
            self._begin(self._next_leg(decision, observation), observation.poses)
            decision = self._decide(motion, observation)
        if not isinstance(decision, Plan):
            return decision
        leg = self.progress.leg.index
        self.progress = self.progress.after(decision)
        plan = replace(decision, leg=leg, estimate=self.estimator.estimate)
        return plan.of_all(self.course.present, observation.poses)

    # legs

    def _ends_a_leg_only(self, decision: Decision) -> bool:
        """Return whether a decision ends a leg after which there is another."""
        if not isinstance(decision, Outcome) or decision not in PASSED:
            return False
        return self.progress.state is not State.STUCK and not self._in_last_leg

    def _next_leg(self, decision: Decision, observation: Observation) -> Leg:
        """Return the leg that begins after a decision that ended one."""
        return Leg(
            index=self.progress.leg.index + 1,
            began_s=self.time.passed_s,
            began_ns=observation.sampled_ns,
            moving=self.progress.moving,
            outcome=Outcome(decision),
        )

    def _begin(self, leg: Leg, poses: Poses) -> None:
        """Begin a leg with robots at `poses`, in which plans are made afresh."""
        self.progress = replace(self.progress, leg=leg, last=None)
        self.course = self._course(leg.index, poses)

    def _course(self, index: int, poses: Poses) -> Course:
        """Return the course of a leg. Lost robots on wheels, at `poses`, are obstacles."""
        present = self.estimator.left
        targets = self.legs[min(index, len(self.legs) - 1), present]  # a hold is at the targets
        walls = self.setup.arena if self.section.collision.walls else None
        radius = self.section.collision.radius
        bodies = []
        if radius and self.setup.wheel_radius:
            bodies = [Shape(place, radius) for place in poses.xy[~present, None]]
        margins = Margins([*self.setup.obstacles, *bodies], walls, targets, radius)
        return Course(present, targets, margins)

    @property
    def _holds(self) -> bool:
        """Whether this leg is the hold."""
        return self.progress.leg.index == len(self.legs)

    @property
    def _in_last_leg(self) -> bool:
        """Whether the trial ends with this leg: the hold, or without one the leg to the targets."""
        return self.progress.leg.index == len(self.legs) - (0 if self.setup.hold else 1)

    # a step

    def _decide(self, motion: Problem, observation: Observation) -> Decision:
        """Return what the robots do, or how the leg ends, given their states and motion."""
        step = self._step(motion)
        outcome = self._outcome(step, observation)
        if outcome is not None:
            return outcome
        if self._holds and self.setup.wheel_radius is None:
            return self._circle(step)
        if step.warm is None:
            return self._at_rest(step)
        return self._under_way(step, step.warm)

    def _step(self, motion: Problem) -> ControlStep:
        """Return what the step begins with, given the robots' states and motion."""
        section = self.section
        held_periods = 0  # for which the present signal has been held
        warm = None
        if self.progress.last is not None and not self.progress.last.pauses:
            held_periods = (self.progress.k - self.progress.began) % section.signal_periods
            used = 1 if held_periods == 0 else 0
            warm = self.progress.last.signals[used:]
        first_period = (section.signal_periods - held_periods) * section.period
        motion = replace(motion, targets=self.course.targets, first_period=first_period)
        problem = self._with_margins(motion, self.estimator.known)
        value = Worth(
            accept=section.accept_error,
            spent_s=self.time.passed_s - self.progress.leg.began_s,
            period_s=problem.period,
            patience_s=section.patience_s(self.setup),
            sticking_hz=self._sticking_hz,
        )
        left_s = self.time.left_s + held_periods * section.period
        return ControlStep(problem, warm, section.horizon_max, left_s / problem.period, value)

    @property
    def _sticking_hz(self) -> float:
        """How often robots on wheels were found to stick [1/s]. Cells, which rest by themselves and
        then go on, have 0: with such a price some trials ended far from their targets."""
        if self.setup.wheel_radius is None:
            return 0.0
        return self.standings.rate_hz(self.time.passed_s)

    def _outcome(self, step: ControlStep, observation: Observation) -> Outcome | None:
        """Return how the leg ends whatever robots could do, None if it goes on."""
        leg = self.progress.leg
        if self._holds:
            assert self.setup.hold is not None
            if observation.sampled_ns - leg.began_ns >= self.setup.hold.seconds * SECOND:
                return leg.outcome
        elif self.section.arrived(step.problem.poses.distances(step.problem.targets)):
            return Outcome.ARRIVED
        if self.time.over:
            return Outcome.TIME_LIMIT
        if self.progress.state is State.STUCK:
            return Outcome.NO_BETTER_PLAN
        return None

    def _circle(self, step: ControlStep) -> Plan:
        """Return a plan that keeps robots near their targets if they cannot stand still."""
        assert self.setup.hold is not None
        problem = replace(step.problem, within=self.setup.hold.radius)
        length = max(2, math.ceil(CircleSearch.ahead_s / problem.period))
        limits = Limits(None, self._expired())
        search = self.circler.search(problem, length, step.warm, self._step_key, limits)
        seen = compiled_foresee(problem, search.signals)
        return replace(make_plan([search], 0, self._step_key, seen), state=State.HOLDING)

    # under way

    def _under_way(self, step: ControlStep, warm: Floats) -> Decision:
        """Decide while a plan is under way."""
        if self.progress.state is State.PASSING and len(warm) > AHEAD:
            return self._pass(step, warm)
        bounds = self._bounds(step, warm)
        decision = self._stop(step, warm, bounds)
        if decision is not None:
            return decision
        found = self._search_under_way(step, warm)
        decision = self._go_on(found, bounds)
        if decision is not None:
            return decision
        return self._rest(found)

    def _bounds(self, step: ControlStep, warm: Floats) -> LengthBounds:
        """Return the least values of going on and of a rest."""
        go_on = np.inf
        rest = np.inf
        if len(warm):
            go_on = self._value(step, warm, compiled_foresee(step.problem, warm))
        least = least_length(step.problem)
        if step.allows(least, 0.0):  # time for a new attempt
            go_on = min(go_on, step.value.plan(0.0, len(warm) + 2, new=True))
            driven_s = (self.progress.k - self.progress.began) * self.section.period
            wait_s = PAUSE_S + self.section.period + self.estimator.dead_time_s
            may_rest = self.stands and self._in_last_leg and driven_s > RESTED_S
            if may_rest and step.allows(least, wait_s):
                rest = step.value.rest(least, wait_s)
        return LengthBounds(go_on, rest)

    def _pass(self, step: ControlStep, warm: Floats) -> Plan:
        """Go on through a passage: search the next AHEAD signals again, to bring robots where the
        plan from rest led them then; the rest of that plan stays. Rest if they would miss it.

        Errors of the model in the first of some 90 signals would otherwise add up until the last.
        """
        last = self.progress.last
        assert last is not None
        way = last.path[len(last.signals) - len(warm) :]
        near = ahead(step.problem, way)
        limits = Limits(None, self._expired())
        search = self.optimizer.search(near, AHEAD, warm[:AHEAD], self._step_key, limits)
        seen = compiled_foresee(near, search.signals)
        left = float(Poses.of(way[AHEAD]).distances(step.problem.targets).sum())
        driven_s = (self.progress.k - self.progress.began) * self.section.period
        misses = seen.target > MISS_MAX * self.section.accept_error + MISS_OF_WAY * left
        strays = misses and driven_s > TRUSTED_S
        if self.stands and (strays or self._enters(step.problem, search.signals)):
            return self._standing(step.problem, State.RESTING, [search])
        signals = np.append(search.signals, warm[AHEAD:])
        plan = self._given(step.problem, signals, State.PASSING, [search])
        return replace(plan, path=np.concatenate([seen.path, way[AHEAD + 1 :]]))

    def _stop(self, step: ControlStep, warm: Floats, bounds: LengthBounds) -> Decision | None:
        """Stop at the best moment of the coming control period if nothing can be worth more than
        the error that is left then: searches take time in which robots would drive on."""
        problem = step.problem
        period_s = self.section.period if self._in_last_leg else 0.0
        if least_error(problem, period_s) > min(bounds):
            return None
        held = self.estimator.held_at_action
        stop = best_stop(problem, held, period_s)
        seconds = stop.delay_ns / SECOND + REACTION_S  # the guard looks so far ahead
        if stop.delay_ns and self.stands and self.course.margins.meets(problem, held, seconds):
            stop = best_stop(problem, held, 0.0)
        if stop.error > min(bounds):
            return None
        if self._holds or (self.stands and self._in_last_leg):
            return replace(self._standing(problem, State.RESTING), delay_ns=stop.delay_ns)
        outcome = Outcome.NO_BETTER_PLAN if len(warm) else Outcome.SEQUENCE_COMPLETED
        return End(outcome, stop.delay_ns) if stop.delay_ns else outcome

    def _go_on(self, found: Searched, bounds: LengthBounds) -> Plan | None:
        """Follow the plan of least value that is safe, unless a rest can be worth more."""
        for candidate in found.candidates:
            if not self.stands:
                return self._planned(found, candidate)
            if candidate.value > bounds.rest:
                return None
            plan = self._planned(found, candidate)
            if not self._enters(found.problem, plan.signals):
                return plan
        return None

    def _rest(self, found: Searched) -> Plan:
        """Stop, and search a new plan while the robots stand."""
        return self._standing(found.problem, State.RESTING, found.searches)

    def _search_under_way(self, step: ControlStep, warm: Floats) -> Searched:
        """Search plans about as long as the one under way, and longer ones as far as these can be
        worth more; end if one of the former is good enough."""
        searcher = self._searcher(step)
        good_enough = self.section.optimizer.good_enough or 0.0
        candidates: list[Candidate] = []
        for length, start in self._lengths(step, warm):
            if start is None:
                least = step.value.plan(0.0, length, new=True)
                if least >= min(candidate.value for candidate in candidates):
                    continue
            search = searcher.search(length, start)
            if search is None:  # the deadline has passed
                break
            candidate = self._candidate(step, searcher.found, len(searcher.found) - 1)
            candidates.append(candidate)
            enough = step.value.plan(good_enough, length, new=False)
            if start is not None and search.cost <= good_enough and candidate.value <= enough:
                candidates = [candidate]
                break
        candidates.sort(key=lambda candidate: candidate.value)
        return Searched(step.problem, searcher.found, candidates)

    def _lengths(self, step: ControlStep, warm: Floats) -> Iterator[tuple[int, Floats | None]]:
        """Yield the lengths to search, with the signals to begin with: what is left of the plan
        under way, without its first signal, and with one more; then longer plans, searched afresh,
        which continue after the longest that the step before searched."""
        assert self.progress.last is not None
        count = len(warm)
        most = step.signals_max
        starts = (count, warm), (count - 1, warm[1:]), (count + 1, np.append(warm, 0.0))
        for length, start in starts:
            if 0 < length <= max(most, 1):
                yield length, start
        for length in longer(count, most, self.progress.last.searches[-1].length):
            yield length, None

    # at rest

    def _at_rest(self, step: ControlStep) -> Plan | Outcome:
        """Decide while no plan is under way."""
        for propose in (self._stay, self._finish):
            decision = propose(step)
            if decision is not None:
                return decision
        found = self._search_at_rest(step)
        best = self._planned(found, found.candidates[0])
        for propose_for in (self._turn, self._give_up):
            plan = propose_for(found, best)
            if plan is not None:
                return plan
        return self._drive(found, best)

    def _stay(self, step: ControlStep) -> Plan | None:
        """Stand on in a hold while all robots are within its radius."""
        gaps = step.problem.poses.distances(step.problem.targets)
        if self._holds and self.setup.hold and (gaps <= self.setup.hold.radius).all():
            return self._standing(step.problem, State.RESTING)
        return None

    def _finish(self, step: ControlStep) -> Plan | Outcome | None:
        """End the leg, or stand on in a hold, if robots stand and no plan can be worth an attempt
        or none fits into the time left."""
        if self.progress.k == 0 or self.progress.moving:
            return None
        least = least_length(step.problem)
        error = float(step.problem.poses.distances(step.problem.targets).sum())
        attempt = step.value.plan(0.0, min(least, max(1, step.signals_max)), new=True)
        if error > attempt and step.allows(least, 0.0):
            return None
        if self._holds:
            return self._standing(step.problem, State.RESTING)
        return Outcome.NO_BETTER_PLAN

    def _turn(self, found: Searched, best: Plan) -> Plan | None:
        """Turn on the spot if a body would touch something on the way of the best plan found; not
        after all turns were in vain."""
        touches = self.course.margins.entered(best.path)
        if not (self.stands and (touches or self._enters(found.problem, best.signals))):
            return None
        apart = self.section.collision.separation
        turning = self.progress.turning
        facing = next_facing(found.problem, self.course.margins, apart, turning)
        if facing is None:
            return None
        standing = self._standing(found.problem, State.TURNING, found.searches)
        return replace(standing, instead=Turn(facing))

    def _give_up(self, found: Searched, best: Plan) -> Plan | None:
        """Stand, and end the trial in the next step, if the best plan found would bring a body into
        something before a stop can act."""
        if self.stands and self._enters(found.problem, best.signals):
            return replace(best, state=State.STUCK, instead=Stop())
        return None

    def _drive(self, found: Searched, best: Plan) -> Plan:
        """Follow the best plan found."""
        if found.passes and best.search.length > AHEAD:
            return replace(best, state=State.PASSING)
        return best

    def _search_at_rest(self, step: ControlStep) -> Searched:
        """Search plans of growing lengths until one is good and, if none is, the plans to which a
        tree of directions leads."""
        searcher = self._searcher(step)
        most = max(1, step.signals_max)
        reached = searcher.spread(
            least_length(step.problem), most, lambda search: self._good(step, step.problem, search)
        )
        if reached or self.progress.moving or not self.section.collision.walls:
            return self._found(step, step.problem, searcher.found, passes=False)
        later = self._with_margins(step.problem, None)  # the motion will be identified by then
        passes = searcher.onward(
            later,
            ways(later, self.setup.arena, most, self._step_key),
            lambda search: self._good(step, later, search),
        )
        return self._found(step, later if passes else step.problem, searcher.found, passes)

    def _good(self, step: ControlStep, problem: Problem, search: Search) -> bool:
        """Return whether a plan found for a problem needs no better one."""
        if search.cost > (self.section.optimizer.good_enough or 0.0):
            return False
        return self._safe(step, search.signals, compiled_foresee(problem, search.signals))

    def _found(
        self, step: ControlStep, problem: Problem, searches: Sequence[Search], passes: bool
    ) -> Searched:
        """Return all plans that searches found, as candidates for the problem."""
        posed = replace(step, problem=problem)
        numbers = range(len(searches))
        candidates = [self._candidate(posed, searches, number) for number in numbers]
        candidates.sort(key=lambda candidate: candidate.value)
        return Searched(problem, searches, candidates, passes)

    # plans, their values, and whether they are safe

    @property
    def _step_key(self) -> int:
        """The key of the step's random numbers."""
        return mix(self.key, self.progress.k)

    def _searcher(self, step: ControlStep) -> Searcher:
        """Return what runs the searches of a step, whose time counts from now."""
        return Searcher(self.optimizer, step.problem, self._step_key, self._expired())

    def _expired(self) -> Callable[[int], bool]:
        """Return whether the deadline of the step, which begins now, has passed."""
        seconds = self.section.deadline if self.progress.moving else SEARCH_S
        end_ns = self.timer() + round(seconds * SECOND)
        return lambda _: self.timer() >= end_ns

    def _candidate(self, step: ControlStep, searches: Sequence[Search], number: int) -> Candidate:
        """Return the plan that a search found as a candidate."""
        search = searches[number]
        seen = compiled_foresee(step.problem, search.signals)
        return Candidate(self._value(step, search.signals, seen, search.cost), number, seen)

    def _value(
        self, step: ControlStep, signals: Floats, seen: Foreseen, cost: float = np.inf
    ) -> float:
        """Return the value of a plan of given signals (L,), whose cost may be known.

        A cost below the weight of an obstacle is the error itself, since nothing is touched.
        """
        error = cost
        touches = False
        if cost >= step.problem.obstacle_weight:
            error = seen.target
            touches = seen.obstacle > 0
        unheard = not self._safe(step, signals, seen)
        return step.value.plan(error, len(signals), step.is_new(signals), touches, unheard)

    def _planned(self, found: Searched, candidate: Candidate) -> Plan:
        """Return the plan of a candidate."""
        return make_plan(found.searches, candidate.number, self._step_key, candidate.seen)

    def _given(
        self, problem: Problem, signals: Floats, state: State, searches: Iterable[Search] = ()
    ) -> Plan:
        """Return a plan of given signals (L,); the `searches` before found no better one."""
        seen = compiled_foresee(problem, signals)
        every = [*searches, given_search(problem, signals, seen)]
        return replace(make_plan(every, len(every) - 1, self._step_key, seen), state=state)

    def _standing(self, problem: Problem, state: State, searches: Iterable[Search] = ()) -> Plan:
        """Return a plan by which robots stand, after `searches` that are kept for the log. It has
        one signal, which is not sent."""
        return replace(self._given(problem, np.zeros(1), state, searches), instead=Stop())

    def _with_margins(self, problem: Problem, known: Estimate | None) -> Problem:
        """Return the problem with its margins, given the estimate `known`, None if certain."""
        grown, apart = self.course.margins.around(
            problem, self.section.collision, self.section.period, self.estimator.dead_time_s, known
        )
        return replace(problem, obstacles=grown, separation=apart)

    def _enters(self, problem: Problem, signals: Floats) -> bool:
        """Return whether a body enters an obstacle before the next stop can act."""
        seconds = self.section.period + LATE * self.estimator.dead_time_s
        held = np.full(len(problem.a), signals[0])
        return self.course.margins.meets(problem, held, seconds)

    def _safe(self, step: ControlStep, signals: Floats, seen: Foreseen) -> bool:
        """Return whether robots keep clear if, after any one of the signals (L,), they receive no
        command for `silence` or until their watchdog stops them.

        The last SILENT_LAST signals are not tested; of the plan under way, only the first
        SILENT_NEXT are.
        """
        collision = self.section.collision
        count = len(signals) - SILENT_LAST
        if not step.is_new(signals):
            count = min(count, SILENT_NEXT)
        if not collision.silence or count <= 0:
            return True
        return self.course.margins.clear_unheard(
            step.problem,
            seen.path,
            signals[:count],
            seconds=min(collision.silence + self.section.period, self.setup.watchdog_s),
            margin=SILENT_ROOM * collision.radius,
            apart=collision.separation,
        )

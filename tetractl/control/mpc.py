"""The recommended controller: model predictive control in which one value decides.

Each control step compares candidates and chooses the one of least value (`tetractl.control.value`),
a stop and a rest before plans are searched, with the least value that a plan can have:

    stop     within the coming control period, and end the trial there
    rest     stop so, and search a new plan while the robots stand
    plan     the plan under way without its first signal, and plans one signal shorter and longer
    longer   longer plans, while they can be worth more and time allows
    turn     at rest: turn on the spot, then search again

What the robots do then is the plan's `State`. docs/reference/controllers/mpc.md draws the states.
As in Algorithm 2 of the paper, plans of several lengths are searched, each from what is left of the
plan under way, and only the first signal is exerted.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tetractl.control.corners import NOT_TURNING, next_facing
from tetractl.control.cost import Foreseen
from tetractl.control.estimator import StateEstimator
from tetractl.control.evaluate import compiled_foresee
from tetractl.control.fixed_sequence import best_stop, given_search, least_error, make_plan
from tetractl.control.holding import CircleSearch, held
from tetractl.control.lengths import Searcher, least_length
from tetractl.control.margins import Margins
from tetractl.control.mpc_section import RecommendedMpc
from tetractl.control.mpc_step import Candidate, Leg, StepStart, search_on
from tetractl.control.passage import AHEAD, FAR, LOST, TRUSTED_S, ahead, ways
from tetractl.control.rng import mix
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
from tetractl.core.poses import Floats, Observation, Poses
from tetractl.core.setup import Setup
from tetractl.core.shape import Shape
from tetractl.core.tour import told_dead
from tetractl.experiment.controller import Host, Square
from tetractl.experiment.lab_section import REACTION_S

RESTED_S = 2.0  # least time that a plan is driven before a rest for a better one [s]
REST_S = 1.0  # time after which the searches of a step end for standing robots [s]
LATE = 2.0  # a stop acts after at most this many dead times: it may be lost once
PASSED = (Outcome.ARRIVED, Outcome.SEQUENCE_COMPLETED, Outcome.NO_BETTER_PLAN)
"""Outcomes after which the next leg (the part of a trial up to a way-point) begins."""


class Mpc:
    """The controller of one trial; `key` seeds all its random numbers.

    Its state between two steps: the number `k` of the step, the `last` plan, the step `began` in
    which robots began to follow plans, the direction they are `turning` to, and the `leg`.
    `timer()`, the time [ns], is read for deadlines alone.
    """

    def __init__(self, section: RecommendedMpc, setup: Setup, key: int, host: Host) -> None:
        self.section, self.setup, self.key, self.timer = section, setup, key, host.timer
        self.optimizer, self.circler = host.wrap(section.optimizer), host.wrap(CircleSearch())
        square = isinstance(section.first_plan, Square)
        self.estimator = StateEstimator(
            section.problem(setup), section.period, section.known(setup), square, setup.loss
        )
        self.stands = section.collision.stop_before_collision
        self.time = TrialTime(section.time_limit, section.period)
        self.k, self.began, self._legs = 0, 0, setup.legs
        self.turning = NOT_TURNING
        self.last: Plan | None
        self._begin(Leg(0, 0.0, 0, False, Outcome.ARRIVED), setup.starts)

    def _begin(self, leg: Leg, poses: Poses) -> None:
        """Begin a leg; lost robots on wheels, at `poses`, are obstacles. Plans are made afresh."""
        self.leg, self.last, self.left = leg, None, self.estimator.left
        self._targets = self._legs[min(leg.index, len(self._legs) - 1), self.left]
        walls = self.setup.arena if self.section.collision.walls else None
        radius, lost = self.section.collision.radius, poses.xy[~self.left, None]
        bodies = [Shape(at, radius) for at in lost if radius and self.setup.wheel_radius]
        self.margins = Margins([*self.setup.obstacles, *bodies], walls, self._targets, radius)

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Plan | Outcome | End:
        """Decide what the robots do in one step, or end the trial."""
        self.time.seen(observation, last_command)
        known = self.estimator.seen(observation, last_command, earlier)
        dead = self.estimator.losses.dead
        if dead.any() and self.setup.loss and self.setup.loss.ends:
            raise ControlError(told_dead(self.setup.names, dead))
        if self.estimator.left is not self.left:
            self._begin(replace(self.leg, moving=self._moving), observation.poses)
        while True:
            step = self._step(known)
            decision = self._decide(step, observation)
            if isinstance(decision, Plan):
                if step.warm is None:
                    self.began = self.k
                self.last, self.k = decision, self.k + 1
                self.turning = self.turning.then(decision.facing)
                found = replace(decision, leg=self.leg.index, estimate=self.estimator.estimate)
                return found.of_all(self.left, observation.poses)
            if decision not in PASSED or self._state is State.STUCK or self._last_leg:
                return decision
            began = self.time.passed_s, observation.sampled_ns, self._moving
            self._begin(Leg(self.leg.index + 1, *began, Outcome(decision)), observation.poses)

    @property
    def _last_leg(self) -> bool:
        """Whether the trial ends with this leg: the hold, or without one the leg to the targets."""
        return self.leg.index == len(self._legs) - (self.setup.hold is None)

    @property
    def _state(self) -> State:
        """What the robots were commanded to do in this leg; they rest before the first step."""
        return State.RESTING if self.last is None else self.last.state

    @property
    def _moving(self) -> bool:
        """Whether the robots drive when the step begins."""
        return self.leg.moving if self.last is None else not self.last.pauses

    def _step(self, known: Problem) -> StepStart:
        """Return what the step decides on, given the robots' states and `known` motion."""
        section, phase, warm = self.section, 0, None
        if self.last is not None and not self.last.pauses:
            phase = (self.k - self.began) % section.signal_periods  # periods held, of the signal
            warm = self.last.signals[phase == 0 :]
        first_period = (section.signal_periods - phase) * section.period
        known = replace(known, targets=self._targets, first_period=first_period)
        problem = self._with_margins(known, self.estimator.known)
        left = (self.time.left_s + phase * section.period) / problem.period
        spent_s = self.time.passed_s - self.leg.began_s
        value = Worth(section.accept_error, spent_s, problem.period, section.patience_s(self.setup))
        return StepStart(problem, warm, section.horizon_max, left, value)

    def _decide(self, step: StepStart, observation: Observation) -> Plan | Outcome | End:
        """Return the candidate of least value, or how the leg ends."""
        problem = step.problem
        gaps = problem.poses.distances(problem.targets)
        holds = self.leg.index == len(self._legs)
        if holds:
            assert self.setup.hold is not None
            if observation.sampled_ns - self.leg.began_ns >= self.setup.hold.seconds * SECOND:
                return self.leg.outcome
        elif self.section.arrived(gaps):
            return Outcome.ARRIVED
        if self.time.over:
            return Outcome.TIME_LIMIT
        if self._state is State.STUCK:
            return Outcome.NO_BETTER_PLAN
        if holds and self.setup.wheel_radius is None:
            return self._circle(step)
        if step.warm is None:
            return self._at_rest(step, gaps, holds)
        if self._state is State.PASSING and len(step.warm) > AHEAD:
            return self._passing(step, step.warm)
        return self._under_way(step, step.warm, holds)

    def _passing(self, step: StepStart, warm: Floats) -> Plan:
        """Go on through a passage, with the signals `warm` left: the next AHEAD are searched again,
        to bring robots where the plan from rest led them; the rest of that plan stays."""
        assert self.last is not None
        problem, way = step.problem, self.last.path[len(self.last.signals) - len(warm) :]
        near, key, limits = ahead(problem, way), mix(self.key, self.k), self._expired()
        found = self.optimizer.search(near, AHEAD, warm[:AHEAD], key, Limits(None, limits))
        seen = compiled_foresee(near, found.signals)
        left = float(Poses.of(way[AHEAD]).distances(problem.targets).sum())
        lost = seen.target > LOST * self.section.accept_error + FAR * left
        lost &= (self.k - self.began) * self.section.period > TRUSTED_S
        if self.stands and (lost or self._enters(problem, found.signals)):
            return self._given(problem, State.RESTING, before=[found])
        plan = self._given(problem, State.PASSING, np.append(found.signals, warm[AHEAD:]), [found])
        return replace(plan, path=np.concatenate([seen.path, way[AHEAD + 1 :]]))

    def _under_way(self, step: StepStart, warm: Floats, holds: bool) -> Plan | Outcome | End:
        """Decide while a plan is under way, of which the signals `warm` are left."""
        problem, value, last = step.problem, step.value, self._last_leg
        goes_on = rest = np.inf
        if len(warm):
            goes_on = self._worth(step, warm, compiled_foresee(problem, warm))
        least = least_length(problem)
        wait_s = PAUSE_S + self.section.period + self.estimator.dead_time_s
        if step.allows(least, 0.0):  # time for a new attempt
            goes_on = min(goes_on, value.plan(0.0, len(warm) + 2, True))
            driven_s = (self.k - self.began) * self.section.period
            if self.stands and last and driven_s > RESTED_S and step.allows(least, wait_s):
                rest = value.rest(least, wait_s)
        period, held = self.section.period if last else 0.0, self.estimator.held_at_action
        if least_error(problem, period) <= min(goes_on, rest):
            stop = best_stop(problem, held, period)
            seconds = stop.delay_ns / SECOND + REACTION_S  # the guard looks so far ahead
            if stop.delay_ns and self.stands and self.margins.meets(problem, held, seconds):
                stop = best_stop(problem, held, 0.0)
            if stop.error <= min(goes_on, rest):
                if holds or (self.stands and last):
                    return self._given(problem, State.RESTING, delay_ns=stop.delay_ns)
                outcome = Outcome.NO_BETTER_PLAN if len(warm) else Outcome.SEQUENCE_COMPLETED
                return End(outcome, stop.delay_ns) if stop.delay_ns else outcome
        searcher = Searcher(self.optimizer, problem, mix(self.key, self.k), self._expired())
        assert self.last is not None
        good_enough, after = self.section.optimizer.good_enough, self.last.searches[-1].length
        valued = search_on(searcher, step, warm, good_enough or 0.0, after, self._valued)
        for candidate in sorted(valued, key=lambda one: one.worth):
            if self.stands and candidate.worth > rest:
                break
            plan = self._planned(searcher, candidate)
            if not (self.stands and self._enters(problem, plan.signals)):
                return plan
        return self._given(problem, State.RESTING, before=searcher.found)

    def _worth(
        self, step: StepStart, signals: Floats, seen: Foreseen, cost: float = np.inf
    ) -> float:
        """Return the value of a plan of given signals (L,), whose cost may be known."""
        touched = cost >= step.problem.obstacle_weight
        error, touches = (seen.target, seen.obstacle > 0) if touched else (cost, False)
        unheard = not self._safe(step, signals, seen)
        return step.value.plan(error, len(signals), step.is_new(signals), touches, unheard)

    def _valued(self, search: Search, step: StepStart) -> Candidate:
        """Return a plan found, with its value and its prediction."""
        seen = compiled_foresee(step.problem, search.signals)
        return Candidate(self._worth(step, search.signals, seen, search.cost), search, seen)

    def _at_rest(self, step: StepStart, gaps: Floats, holds: bool) -> Plan | Outcome:
        """Decide while no plan is under way."""
        problem, value = step.problem, step.value
        error, stood = float(gaps.sum()), self.k > 0 and not self._moving
        least, most = least_length(problem), max(1, step.signals_max)
        again = value.plan(0.0, min(least, most), True)
        if holds and self.setup.hold is not None and (gaps <= self.setup.hold.radius).all():
            return self._given(problem, State.RESTING)
        if stood and (error <= again or not step.allows(least, 0.0)):
            return self._given(problem, State.RESTING) if holds else Outcome.NO_BETTER_PLAN
        searcher = Searcher(self.optimizer, problem, mix(self.key, self.k), self._expired())
        good_enough = self.section.optimizer.good_enough or 0.0

        def good(search: Search) -> bool:
            seen = compiled_foresee(searcher.problem, search.signals)
            return search.cost <= good_enough and self._safe(step, search.signals, seen)

        reached, passes = searcher.spread(least, most, good), False
        if not (reached or self._moving) and self.section.collision.walls:
            later = self._with_margins(problem, None)  # the motion will be identified by then
            starts = ways(later, self.setup.arena, most, mix(self.key, self.k))
            passes = searcher.onward(later, starts, good)
            step = replace(step, problem=searcher.problem)
        plan = self._best(searcher, step)
        plan = replace(plan, state=State.PASSING) if passes and plan.search.length > AHEAD else plan
        out = self._turn(searcher, plan)
        if out is None and self.stands and self._enters(problem, plan.signals):
            return replace(plan, state=State.STUCK, instead=Stop())
        return out or plan

    def _best(self, searcher: Searcher, step: StepStart) -> Plan:
        """Return the plan of least value that was found."""
        best = min((self._valued(one, step) for one in searcher.found), key=lambda one: one.worth)
        return self._planned(searcher, best)

    def _turn(self, searcher: Searcher, best: Plan) -> Plan | None:
        """Return a turn on the spot of standing robots in a corner, where the `best` plan found is
        not safe; None if it is safe, or enough turns were in vain."""
        problem = searcher.problem
        known = self.section.period, self.estimator.dead_time_s, self.estimator.known
        touches = best.obstacle_cost > 0
        touches = touches and self.margins.cornered(problem, self.section.collision, *known)
        if not (self.stands and (touches or self._enters(problem, best.signals))):
            return None
        facing = next_facing(problem, self.margins, self.turning)
        if facing is None:
            return None
        turning = self._given(problem, State.TURNING, before=searcher.found)
        return replace(turning, instead=Turn(facing))

    def _planned(self, searcher: Searcher, candidate: Candidate) -> Plan:
        """Return the plan of a candidate."""
        chosen = next(i for i, one in enumerate(searcher.found) if one is candidate.search)
        return make_plan(searcher.found, chosen, mix(self.key, self.k), candidate.seen)

    def _given(
        self,
        problem: Problem,
        state: State,
        signals: Floats | None = None,
        before: Sequence[Search] = (),
        delay_ns: int = 0,
    ) -> Plan:
        """Return a plan of given signals (L,), none of which is sent while the robots stand; the
        searches `before` have found no better one."""
        signals = np.zeros(1) if signals is None else signals
        seen = compiled_foresee(problem, signals)
        found = given_search(problem, signals, seen)
        plan = make_plan([*before, found], len(before), mix(self.key, self.k), seen)
        instead = Stop() if state in (State.RESTING, State.STUCK) else None
        return replace(plan, state=state, instead=instead, delay_ns=delay_ns)

    def _circle(self, step: StepStart) -> Plan:
        """Return a plan that keeps robots near their targets if they cannot stand still."""
        key, limits = mix(self.key, self.k), Limits(None, self._expired())
        found, seen = held(step, self.setup, self.circler, key, limits)
        return replace(make_plan([found], 0, key, seen), state=State.HOLDING)

    def _with_margins(self, problem: Problem, known: Estimate | None) -> Problem:
        """Return the problem with its margins, given the estimate `known`, None if certain."""
        times = self.section.period, self.estimator.dead_time_s
        grown, apart = self.margins.around(problem, self.section.collision, *times, known)
        return replace(problem, obstacles=grown, separation=apart)

    def _enters(self, problem: Problem, signals: Floats) -> bool:
        """Return whether a body enters an obstacle before the next stop can act."""
        seconds = self.section.period + LATE * self.estimator.dead_time_s
        return self.margins.meets(problem, np.full(len(problem.a), signals[0]), seconds)

    def _expired(self) -> Callable[[int], bool]:
        """Return whether the deadline of the step, which begins now, has passed."""
        seconds = self.section.deadline if self._moving else REST_S
        end = self.timer() + round(seconds * SECOND)
        return lambda _: self.timer() >= end

    def _safe(self, step: StepStart, signals: Floats, seen: Foreseen) -> bool:
        """Return whether robots keep clear if they receive no command for `silence` or until their
        watchdog stops them."""
        seconds = min(self.section.collision.silence + self.section.period, self.setup.watchdog_s)
        return step.clear_unheard(self.margins, self.section.collision, signals, seen, seconds)

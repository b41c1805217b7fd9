"""Model predictive control, Algorithm 2: choose the horizon, exert the first signal, warm start.

Where each line of Algorithm 2 is:

    2-4     for h = 1 ... h_max: u_(h) = pso(NULL)                        lengths.candidates
    5, 23   u_(opt) = the u_(h) of the least J                            lengths.choose
    6, 24   u_(warm) = u_(opt) without its first signal                   plan, at the next step
    7, 25   exert u_(opt)(1)                                              run.trial, from plan
    9, 26   for k = 1 ... k_max                                           plan, by run.trial
    10      H = length of u_(warm)                                        lengths.candidates
    11, 22  for h = H - 1, H, H + 1                                       lengths.candidates,
            H first if the optimiser has a tolerance                      Searcher.search_all
    12      feedback of the robots, once per step                         plan
    13-15   break if the robots are close enough to their targets         plan
    16-17   u_gb^0 = u_(warm) and a 0, for h = H + 1                      lengths.candidates
    18-20   u_gb^0 = the last h signals of u_(warm), for the others       lengths.candidates
    21      u_(h) = pso(u_gb^0), by any optimiser                         lengths.Searcher

Extensions, each with its field of `controller`: a plan may hold each signal for several control
periods (`hold`); poses may be predicted over the dead time (`dead_time`); the motion may be
identified while robots drive (`estimate`); margins may grow with the uncertainty, and robots pause,
or turn on the spot, before an obstacle that no plan avoids (`collision`); longer sequences may be
searched if no short one ends at the targets (`accept_error`); the stop may come between two steps
(`stop_between`). By the experiment's fields `robots.via` and `hold` (not `controller.hold`), robots
may pass way-points and stay at their targets.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import ClassVar

import numpy as np

from tetractl.control.cost import evaluate
from tetractl.control.delay import driven
from tetractl.control.detour import ENOUGH, away, best_stop, growth, late, longer
from tetractl.control.estimator import StateEstimator
from tetractl.control.evaluate import compiled_foresee, compiled_path
from tetractl.control.filter import warm_up as warm_up_filter
from tetractl.control.fixed_sequence import given_search, make_plan
from tetractl.control.holding import CircleSearch, signals_ahead
from tetractl.control.lengths import Searcher, affordable, candidates, choose, least_length
from tetractl.control.margins import Margins, off_course
from tetractl.control.mpc_section import MpcFields
from tetractl.control.rng import mix
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command
from tetractl.core.plan import End, Estimate, Limits, Outcome, Plan, Problem, Search, never
from tetractl.core.poses import Floats, Observation
from tetractl.core.protocols import Optimizer
from tetractl.core.setup import Setup
from tetractl.experiment.controller import OptimizerSection, Square, same

RESTED_S = 2.0  # least time between two pauses for lack of a safe plan [s]
NEXT = 2  # number of next signals of the present plan that must be safe
TURN_STEPS = 4  # number of steps for which robots turn on the spot
TURNS = 3 * TURN_STEPS  # largest number of these steps before robots drive again
UNSURE = 2  # number of last signals of a plan that need not be safe
KEPT = 0.2  # clearance while robots receive no command, as a fraction of their radius
LATE = 2.0  # a stop acts after at most this many dead times: it may be lost once
TESTED = np.linspace(0, 1, 5)  # parts of the time until a stop acts, at which paths are tested
PASSED = (Outcome.ARRIVED, Outcome.SEQUENCE_COMPLETED, Outcome.NOTHING_BETTER)
"""Outcomes after which the next leg (the part of a trial up to a way-point) begins."""


class Mpc:
    """The controller of one trial; `key` seeds all its random numbers.

    `timer()`, the time [ns], is read only if the section sets a deadline.
    """

    def __init__(
        self,
        section: MpcFields,
        setup: Setup,
        key: int,
        optimizer: Optimizer,
        circler: Optimizer,
        timer: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        self.section = section
        problem, prior = section.problem(setup), section.known(setup)
        square = isinstance(section.first_plan, Square)
        self.setup, self.legs, self.leg = setup, setup.legs, 0
        self.estimator = StateEstimator(problem, section.period, prior, square, setup.loss)
        self.hold, self.stands = setup.hold, setup.wheel_radius is not None
        self.held: tuple[int, Outcome] | None = None  # start of the hold [ns], and its outcome
        self._begin_leg()
        self.optimizer, self.circler = optimizer, circler
        self.key, self.timer = key, timer
        self.k, self.moving = 0, False
        self.leaving = False  # whether the plan leads robots out of a corner
        self.blocked = False  # whether the last plan touches an obstacle or its margin
        self.left_over = 0.0  # predicted total error at the end of the last plan
        self.began = 0  # step k of the last plan for standing robots
        self.facing: float | None = None  # direction to which robots now turn on the spot [rad]
        self.turns = 0  # number of steps in which robots turned on the spot since they drove
        self.stuck = False  # whether no standing robot could move safely
        self.resume = 0  # length with which the search for longer sequences continues, or 0

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Plan | Outcome | End:
        """Decide u_(opt) of one control step, or end the trial."""
        if self.warm is not None and self._phase == 0:
            self.warm = self.warm[1:]  # lines 6, 24
        first_period = (self.section.hold - self._phase) * self.section.period
        known = self.estimator.seen(observation, last_command, earlier)
        if (self.estimator.left != self.left).any():
            self._begin_leg()
        while True:
            targets = self.legs[min(self.leg, len(self.legs) - 1), self.left]
            problem = replace(known, targets=targets, first_period=first_period)
            problem = self._with_margins(problem, self.estimator.known)
            decision = (self._drive if self.held is None else self._stay)(problem, observation)
            if isinstance(decision, Plan):
                self.moving = not decision.pauses
                return replace(decision, leg=self.leg).of_all(self.left, observation.poses)
            if decision not in PASSED or self.stuck or self.leg == self.last_leg:
                return decision
            self.leg += 1
            if self.leg < len(self.legs):
                self._begin_leg()
            else:
                self.held, self.warm = (observation.sampled_ns, Outcome(decision)), None

    @property
    def _phase(self) -> int:
        """Number of control periods for which the plan's present signal has been held."""
        return 0 if self.warm is None else (self.k - self.began) % self.section.hold

    @property
    def last_leg(self) -> int:
        """Index of the last leg: the hold if there is one, otherwise the leg to the targets."""
        return len(self.legs) - (self.hold is None)

    @property
    def accept(self) -> float:
        """Total error accepted at present [length unit]."""
        return self.accepted * late(self.k / self.section.steps_max)

    def _begin_leg(self) -> None:
        """Start planning to the next way-points or targets, for the robots that are not lost."""
        self.left = self.estimator.left  # True for each robot that is not lost, (N,)
        walls = self.setup.arena if self.section.collision.walls else None
        targets = self.legs[min(self.leg, len(self.legs) - 1), self.left]
        self.margins = Margins(self.setup.obstacles, walls, targets, self.section.collision.radius)
        self.accepted = self.section.accept_error  # total error, without the factor `late`
        self.warm: Floats | None = None  # u_(warm), None before the first plan

    def _stay(self, problem: Problem, observation: Observation) -> Plan | Outcome | End:
        """Decide how robots stay near their targets until the hold's time is over."""
        assert self.hold is not None
        assert self.held is not None
        if observation.sampled_ns - self.held[0] >= round(self.hold.seconds * SECOND):
            return self.held[1]
        if self.k > self.section.steps_max:
            return Outcome.STEPS_MAX
        if not self.stands:
            return self._circle(replace(problem, within=self.hold.radius))
        gaps = problem.poses.distances(problem.targets)
        if self.warm is None and (gaps <= self.hold.radius).all():
            return self._pause(problem)
        decision = self._drive(problem, observation)
        return decision if isinstance(decision, Plan) or self.stuck else self._pause(problem)

    def _circle(self, problem: Problem) -> Plan:
        """Return a plan that keeps robots near their targets if they cannot stand still."""
        step_key, limits = mix(self.key, self.k), Limits(None, self._expired())
        length = signals_ahead(problem.period)
        found = self.circler.search(problem, length, self.warm, step_key, limits)
        self.warm, self.k = found.signals, self.k + 1
        plan = make_plan(problem, [found], 0, step_key)
        return replace(plan, estimate=self.estimator.estimate)

    def _drive(self, problem: Problem, observation: Observation) -> Plan | Outcome | End:
        """Decide the next direction towards the problem's targets."""
        gaps = problem.poses.distances(problem.targets)
        if self.section.arrived(gaps):  # lines 13-15
            return Outcome.ARRIVED
        if self.k > self.section.steps_max:  # line 9
            return Outcome.STEPS_MAX
        if self.stuck:
            return Outcome.NOTHING_BETTER
        if self.facing is not None:  # turn further, then rest
            return self._pause(problem, facing=self.facing if self.turns % TURN_STEPS else None)
        if self.warm is None and self.k > 0 and self.accept > 0:
            least = min(least_length(problem), self.section.horizon_max)
            in_time = self.moving or least <= self._signals_left()
            if float(gaps.sum()) <= self.accept or not in_time:
                return Outcome.NOTHING_BETTER
        stops = self.section.collision.stop_before_collision
        if self.warm is not None:
            if stops and self.blocked and self._enters(problem, observation, self.warm):
                self.leaving = False  # the way out was too short
                return self._pause(problem)
            if self.leaving:
                return self._given(problem, self.warm) if len(self.warm) else self._pause(problem)
        if ended := self._ended(problem, observation, gaps):
            if not stops or self.accept == 0 or self.leg < self.last_leg:
                return ended
            delay_ns = ended.delay_ns if isinstance(ended, End) else 0
            return replace(self._pause(problem), delay_ns=delay_ns)  # to end at rest
        plan = self._decide(problem)
        self.blocked, self.left_over = plan.obstacle_cost > 0, plan.target_cost
        if stops and self.blocked:
            if self.warm is None:
                enters = self._enters(problem, observation, plan.signals)
                room = problem, self.margins, self.section.collision.separation
                look = enters or not self.leaving
                out, facing = away(*room, self.turns < TURNS) if look else (None, None)
                if out is not None:
                    self.began, self.leaving = self.k, True
                    return self._given(problem, out, plan.searches)
                if enters or facing is not None:
                    # the trial ends after a pause, in whose step the searches are logged
                    self.stuck = facing is None
                    return self._pause(problem, plan, facing)
            rested = (self.k - self.began) * self.section.period
            if self.warm is not None and plan.cost > self.accept > 0 and rested > RESTED_S:
                return self._pause(problem, plan)
        if self.warm is None:
            self.began = self.k
        self.warm, self.leaving, self.turns, self.k = plan.signals, False, 0, self.k + 1
        return plan

    def _pause(
        self, problem: Problem, found: Plan | None = None, facing: float | None = None
    ) -> Plan:
        """Return the plan that stops all robots, or turns them on the spot to `facing` [rad]; the
        searches of the plan `found` are logged too. The next plan is for standing robots."""
        if found is None:
            stand = given_search(problem, np.zeros(1))
            found = make_plan(problem, [stand], 0, mix(self.key, self.k))
        self.warm, self.blocked, self.resume, self.k = None, False, 0, self.k + 1
        self.facing, self.turns = facing, self.turns + (facing is not None)
        return replace(found, estimate=self.estimator.estimate, pauses=True, facing=facing)

    def _given(self, problem: Problem, signals: Floats, before: Sequence[Search] = ()) -> Plan:
        """Return a plan of given signals (L,); the searches `before` have found no safe plan."""
        searches = [*before, given_search(problem, signals)]
        plan = make_plan(problem, searches, len(before), mix(self.key, self.k))
        self.warm, self.blocked, self.k = signals, True, self.k + 1
        return replace(plan, estimate=self.estimator.estimate)

    def _with_margins(self, problem: Problem, known: Estimate | None) -> Problem:
        """Return the problem with its margins. Adaptive margins grow by the distance that robots
        may leave their course, given the estimate `known`, which is None for a certain motion."""
        collision = self.section.collision
        if not collision.adaptive:
            return problem
        off = off_course(problem.speed, self.section.period, self.estimator.dead_time_s, known)
        margin = collision.margin + collision.radius + off
        apart = collision.separation + 2 * off if collision.separation else 0.0
        return replace(
            problem,
            obstacles=self.margins.obstacles(problem.poses, margin),
            separation=self.margins.separation(problem.poses, apart),
        )

    def _ended(
        self, problem: Problem, observation: Observation, gaps: Floats
    ) -> Outcome | End | None:
        """Return how the trial ends now, because the sequence is completed or stopping costs no
        more than going on; None if the trial goes on.

        `gaps` (N,) are the distances to the targets. The decision uses no search, so all data that
        it depends on are in the log."""
        if self.warm is None or (len(self.warm) > 0 and self.section.accept_error == 0):
            return None
        between = self.section.stop_between and self.leg == self.last_leg  # on the last leg only
        period = self.section.period if between else 0.0
        in_time = len(self.warm) + 2 <= self._signals_left()  # enough for a detour
        accept = self.accept if in_time else max(self.accept, self.left_over)
        if 0 < accept < float((gaps - problem.speed * period).sum()):
            return None  # no stop could be near enough, even at full speed
        stopping = best_stop(problem, self.estimator.held_at_action(observation), period)
        outcome = Outcome.NOTHING_BETTER if len(self.warm) else Outcome.SEQUENCE_COMPLETED
        cost = evaluate(problem, self.warm[None]).total[0] if len(self.warm) else np.inf
        if 0 < accept < stopping.error or float(cost) < stopping.error:
            return None
        return End(outcome, stopping.delay_ns) if stopping.delay_ns else outcome

    def _enters(self, problem: Problem, observation: Observation, warm: Floats) -> bool:
        """Return whether a body enters an obstacle before the next stop can act."""
        held = self.estimator.held_at_action(observation)
        ahead = np.full_like(held, warm[0]) if len(warm) else held
        seconds = self.section.period + LATE * self.estimator.dead_time_s
        x, y, _ = driven(problem, problem.poses, ahead, seconds * TESTED[:, None])
        return self.margins.entered(x, y)

    def _decide(self, problem: Problem) -> Plan:
        """Search every candidate horizon, and longer ones if necessary, and choose the plan.

        The horizons share a limit of evaluations equally. If it is too small for all horizons of
        step 0, fewer horizons, evenly spread, are tried, each with WORTHWHILE times the evaluations
        of the smallest search."""
        section, step_key = self.section, mix(self.key, self.k)
        horizon, most = self._signals_left(), section.evaluations_max
        wanted = list(candidates(self.warm, horizon))
        wanted = [one for one in wanted if one[0] <= horizon] or wanted[:1]
        if most is not None:
            wanted = affordable(wanted, self.warm, most // section.optimizer.evaluations_min)
        searcher = Searcher(
            self.optimizer,
            section.optimizer,
            problem,
            step_key,
            most,
            self._expired(),
            partial(self._safe, problem),
        )
        good_enough = section.optimizer.good_enough
        count = 0 if self.warm is None else len(self.warm)
        if self.warm is None and section.initial_lengths == "geometric" and good_enough is not None:
            searcher.search_spread(least_length(problem), horizon, good_enough)
            if min(search.cost for search in searcher.found) > max(good_enough, self.accept):
                later = self._with_margins(problem, None)  # the motion will be identified by then
                problem = searcher.search_thoroughly(later, horizon, good_enough)
        else:
            enough = good_enough
            if enough is not None and self.accept > 0:
                enough = min(enough, self.accept)  # a cost above it leads to a detour
            searcher.search_all(wanted, enough, count)
        accepted = max(self.accept, good_enough or 0.0)
        good = [search for search in searcher.found if searcher.good(search, accepted)]
        if self.warm is not None and self.accept > 0 and not good:
            self._detour(searcher)
            good = [search for search in searcher.found if searcher.good(search, accepted)]
        among = good or searcher.found
        best = among[choose(among, good_enough, count)]
        if self.warm is not None and best.length > count + 1:
            self.accepted *= growth(problem, count)
        chosen = next(i for i, search in enumerate(searcher.found) if search is best)
        plan = make_plan(problem, searcher.found, chosen, step_key, compiled_foresee)
        return replace(plan, estimate=self.estimator.estimate)

    def _expired(self) -> Callable[[int], bool]:
        if (seconds := self.section.deadline_s) is None or (self.warm is None and not self.moving):
            return never
        end = self.timer() + round(seconds * SECOND)
        return lambda _: self.timer() >= end

    def _detour(self, searcher: Searcher) -> None:
        """Search longer sequences within the limits; the next step continues the search."""
        assert self.warm is not None
        lengths = [n for n in longer(len(self.warm), self._signals_left()) if n >= self.resume]
        self.resume = searcher.search_longer(lengths, ENOUGH * self.accept)

    def _signals_left(self) -> int:
        """Return the largest number of signals of a plan that ends before `steps_max`."""
        return self.section.signals_within(self.section.steps_max + 1 - self.k + self._phase)

    def _safe(self, problem: Problem, signals: Floats) -> bool:
        """Return whether robots keep clear if, after any one of the signals (L,), they receive no
        command for `silence` or until their watchdog stops them.

        The last UNSURE signals are not tested; of a plan under way, only the first NEXT are."""
        collision = self.section.collision
        under_way = self.warm is not None and len(signals) <= len(self.warm) + 1
        count = min(len(signals) - UNSURE, NEXT if under_way else len(signals))
        if not collision.silence or count <= 0:
            return True
        path = compiled_path(problem, signals[:count])[:-1]
        kept = KEPT * collision.radius, collision.separation
        seconds = min(collision.silence + self.section.period, self.setup.watchdog_s)
        return self.margins.clear_unheard(problem, path, signals[:count], seconds, *kept)


class MpcSection(MpcFields):
    """Model predictive control, Algorithm 2, with any optimiser; the paper's is PSO."""

    tours: ClassVar[bool] = True

    def build(
        self,
        setup: Setup,
        key: int,
        wrap: Callable[[OptimizerSection], Optimizer] = same,
        timer: Callable[[], int] = time.perf_counter_ns,
    ) -> Mpc:
        """Return the controller of one trial."""
        return Mpc(self, setup, key, wrap(self.optimizer), wrap(CircleSearch()), timer)

    def warm_up(self, setup: Setup) -> None:
        """Call the planner's functions once so that they are compiled: search for one signal,
        predict the robots' paths under it, and follow robots in a few frames."""
        problem = self.problem(setup)
        found = self.optimizer.search(problem, 1, np.zeros(1), 0, Limits())
        compiled_foresee(problem, found.signals)
        warm_up_filter(self.known(setup), setup.starts)

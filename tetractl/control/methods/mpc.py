"""The recommended controller: model predictive control that compares all options by one value.

One common direction steers all robots. A *signal* is the direction [rad] that all robots follow for
a signal period, and a *plan* is a sequence of signals. A plan is *under way* while robots follow
it. Its remaining signals are called `warm`, because searches start from them. If no plan is under
way, robots are *at rest*: before the first plan, after a pause or a turn on the spot, and when a
leg begins. In the last case they may still drive (`is_moving`). A *leg* is the part of a trial up
to a way-point or to the targets, or the time for which they have to stay there (the hold).

As in Algorithm 2 of the paper, each control step searches plans of several lengths, starting from
the rest of the plan under way, and only the first signal is sent. Besides following a plan, robots
can stop. Each option has a *value* (`tetractl.control.methods.value`), and the lowest value wins.
The value is the predicted sum of distances to the targets at the end [length unit], plus the cost
of the option's time and risk in the same unit.

A plan *collides soon* if its first signal, held until a stop can act, brings a body into something.
Robots that can stand still never follow such a plan, whatever its value (`_collides_soon`).

Two lists of rules decide. The rules of a list are tried one after another, and the first one that
applies decides what the robots do. Each rule is a method with the same name.

    under way                                      at rest

    thread   continue through a gap                stay     in a hold: all are within its radius
    stop     in the coming period, if no plan      finish   if no plan can have a lower value,
             can have a lower value                         or none fits into the time left
    (plans are searched)                           (plans are searched)
    go on    by the plan of lowest value that      turn     on the spot, if the plan of lowest value
             does not collide soon                          collides soon: other headings allow
    rest     if all plans found collide soon                other plans
                                                   give up  if this is still so after all turns
                                                   drive    by the plan of lowest value

**What happens next, if**

    all plans collide soon,       robots pause, and search from there. If they are already at rest,
    or the plan leads astray      only the plan of lowest value counts. They turn on the spot, in up
                                  to 12 turns, and then give up: the next step ends the trial
    a search takes too long       searches end at the spec's `deadline`. The first one is always
                                  completed, and its plan is an option
    no time is left for a new     robots that can stand still: plans are searched first, and a stop
    plan                          is compared with the best one, because the plan under way may have
                                  to be polished to come near the targets
    a step is late                the next step begins with the poses that robots have by then
    few directions get through    a signal is repeated until it ends, and nothing is searched
                                  meanwhile (`tetractl.control.estimation.reception`)
    a pose jumps                  the filter predicts without it (`control.estimation.filter`)
    a robot stops working         ControlError, if the spec requires that this ends the trial.
                                  Otherwise the robot is lost
    a robot is lost               the leg begins again for the others, at rest or driving as they
                                  are. If it has wheels, its body is an obstacle from then on
    all are at their targets,     the leg ends, and the next one begins in the same step. After the
    or a rule ends the leg        last leg, the trial ends
    the time limit is over        the trial ends
    Ctrl-C                        nothing here: the trial ends after a step (`run.control_loop`)

Robots that cannot stand still, such as cells, end a leg where others stop, and never pause or turn
on the spot. The `state` of a plan says what the robots do. docs/reference/controllers/mpc.md draws
the states, and docs/decisions/controller.md describes what was tried instead, with figures.

Times are in seconds, and lengths of plans in signals. N is the number of robots that are not lost,
and L the number of signals of a plan.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tetractl.control.estimation.estimator import StateEstimator
from tetractl.control.methods.fixed_sequence import (
    find_best_stop,
    given_search,
    make_plan,
    min_error,
)
from tetractl.control.methods.lengths import Searcher, longer_lengths, min_length, resample
from tetractl.control.methods.mpc_section import RecommendedMpc
from tetractl.control.methods.passage import (
    FOLLOWED_MIN_S,
    MISS_FRACTION,
    MISS_MAX,
    SIGNALS_AHEAD,
    find_sequences,
    with_targets_ahead,
)
from tetractl.control.methods.trial_time import TrialTime
from tetractl.control.methods.turns import NOT_TURNING, Turning, choose_facing
from tetractl.control.methods.value import CandidateValues
from tetractl.control.search.discs import Discs
from tetractl.control.search.evaluate import compiled_prediction
from tetractl.control.search.holding import CircleSearch
from tetractl.control.search.margins import Margins
from tetractl.control.search.near_targets import spread_targets, target_separation
from tetractl.control.search.rng import mix
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, Stop, Turn
from tetractl.core.errors import ControlError
from tetractl.core.losses import describe_dead
from tetractl.core.motion_estimate import Estimate
from tetractl.core.plan import Decision, End, Limits, Outcome, Plan, Problem, Search, State
from tetractl.core.poses import Bools, Floats, Observation, Poses
from tetractl.core.setup import Setup
from tetractl.core.shape import Shape
from tetractl.spec.controller import Host
from tetractl.spec.lab_section import REACTION_S

SEARCH_S = 1.0
"""Time after which the searches of a step end if robots stand still [s].

While robots drive, they move on during the search, so the searches end after the spec's `deadline`.
"""
STOP_DEAD_TIMES = 2.0
"""Number of dead times after which a stop has certainly taken effect.

It is more than one, because a stop may be lost and is then sent again.
"""
LENGTH_SLACK = 1.15
"""Minimum ratio of a shortened plan's length to the minimum length of a plan.

A plan under way is not shortened below this. Without slack, it could not be corrected later,
because robots do not drive faster.
"""
END_OF_LEG = (Outcome.ARRIVED, Outcome.SEQUENCE_COMPLETED, Outcome.NO_BETTER_PLAN)
"""Outcomes after which the next leg begins, if there is one."""


@dataclass(frozen=True, slots=True)
class Leg:
    """A part of a trial: the way to a way-point, the way to the targets, or the hold after them.

    Attributes:
        index: Index of the way-point, or the number of way-points for the targets.
        is_hold: Whether this leg is the hold.
        is_last: Whether the trial ends with this leg: the hold, or the leg to the targets if there
            is no hold.
        start_s: Time of the trial at which the leg began [s].
        start_ns: Time of the clock at which the leg began [ns].
        outcome: The outcome of the previous leg.
        present: Whether each of all robots is in the trial, False for lost ones.
        targets: Targets of the N robots that are not lost, shape (N, 2). Targets that are too close
            to each other have been moved apart.
        discs: Bodies of the robots.
        margins: Distances that plans keep.
    """

    index: int
    is_hold: bool
    is_last: bool
    start_s: float
    start_ns: int
    outcome: Outcome
    present: Bools
    targets: Floats
    discs: Discs
    margins: Margins


@dataclass(frozen=True, slots=True)
class TrialProgress:
    """The progress of a trial: what the robots have done so far.

    Attributes:
        k: Number of the control step.
        last_plan: The plan of the previous step. None if the leg begins.
        is_moving: Whether robots drive when the step begins.
        steps_driven: Number of steps of the leg in which the robots have driven without a pause. A
            plan is under way unless this is 0.
        turning: The turn on the spot that the robots are making.
    """

    k: int = 0
    last_plan: Plan | None = None
    is_moving: bool = False
    steps_driven: int = 0
    turning: Turning = NOT_TURNING

    @property
    def state(self) -> State:
        """What the robots were last commanded to do. Before the first step, they rest."""
        return State.RESTING if self.last_plan is None else self.last_plan.state

    def with_plan(self, plan: Plan) -> "TrialProgress":
        """Return the progress after a step in which the controller decided on `plan`."""
        is_moving = not plan.pauses
        steps_driven = self.steps_driven + 1 if is_moving else 0
        facing = plan.instead.facing if isinstance(plan.instead, Turn) else None
        turning = self.turning.after_step(facing)
        return TrialProgress(
            k=self.k + 1,
            last_plan=plan,
            is_moving=is_moving,
            steps_driven=steps_driven,
            turning=turning,
        )


@dataclass(frozen=True, slots=True)
class ControlStep:
    """The situation at the beginning of a control step, from which the controller decides.

    Attributes:
        problem: The planning problem: targets, obstacles, and the poses that the robots will have
            when the next command acts.
        warm: The remaining signals of the plan under way, shape (L,). None if no plan is under way.
        horizon_max: Length of the longest plan [signals].
        signals_left: Time until the time limit [signals].
        values: Computes the values of plans.
    """

    problem: Problem
    warm: Floats | None
    horizon_max: int
    signals_left: float
    values: CandidateValues

    @property
    def signals_max(self) -> int:
        """Maximum number of signals of a plan: at most `horizon_max`, and within the time left."""
        return min(self.horizon_max, int(self.signals_left))

    def is_new(self, signals: Floats) -> bool:
        """Check whether signals (L,) are a new plan, not a continuation of the plan under way.

        They are new if no plan is under way, or if they are longer than it by more than one
        signal.
        """
        return self.warm is None or len(signals) > len(self.warm) + 1

    def allows(self, length: int) -> bool:
        """Check whether there is time for a plan with `length` signals before the time limit.

        A length above `horizon_max` counts as `horizon_max`.
        """
        return min(length, self.horizon_max) <= self.signals_left


class SearchResult(NamedTuple):
    """The result of one control step's searches: the problem and the plans that were found.

    Attributes:
        problem: The problem that was searched.
        plans: The plans of all searches, the one with the lowest value first.
        is_from_tree: Whether a tree of directions led to the best plan.
    """

    problem: Problem
    plans: Sequence[Plan]
    is_from_tree: bool = False


class Mpc:
    """The recommended controller, `type: mpc`, in one trial.

    `plan` is called once a control step. Between two steps, the controller keeps the `leg`, the
    `progress` of the trial, and the records of the `estimator` and the `time`.

    Args:
        section: The fields of the controller in the spec.
        setup: The constants of the experiment.
        key: Seed of all random numbers.
        host: Provides the timer, which is read only for deadlines, and wraps the optimiser.
    """

    def __init__(self, section: RecommendedMpc, setup: Setup, key: int, host: Host) -> None:
        self.section = section
        self.setup = setup
        self.key = key
        self.host = host
        self.optimizer = host.wrap(section.optimizer)
        self.estimator = StateEstimator(
            section.problem(setup), section.period, section.known(setup), setup.loss
        )
        self.can_stand_still = section.collision.stop_before_collision
        self.time = TrialTime(section.time_limit, section.period)
        self.leg = self._make_leg(0, 0.0, 0, Outcome.ARRIVED, setup.starts)
        self.progress = TrialProgress()

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Decision:
        """Decide what the robots do in one step, or end the trial; see `Controller.plan`."""
        self.time.add_step(observation, last_command)
        motion = self.estimator.add_step(observation, last_command, earlier)
        dead = self.estimator.losses.dead
        if dead.any() and self.setup.loss and self.setup.loss.ends_trial:
            raise ControlError(describe_dead(self.setup.names, dead))
        poses = observation.poses
        if self.estimator.robots_changed:
            leg = self.leg
            self._begin_leg(
                self._make_leg(leg.index, leg.start_s, leg.start_ns, leg.outcome, poses)
            )
        decision = self._decide(motion, observation)
        while self._ends_only_leg(decision):
            start_s = self.time.elapsed_s
            outcome = Outcome(decision)
            index = self.leg.index + 1
            self._begin_leg(self._make_leg(index, start_s, observation.sampled_ns, outcome, poses))
            decision = self._decide(motion, observation)
        if not isinstance(decision, Plan):
            return decision
        self.progress = self.progress.with_plan(decision)
        plan = replace(decision, leg=self.leg.index, estimate=self.estimator.estimate)
        return plan.extend_to_all(self.leg.present, poses)

    # legs

    def _ends_only_leg(self, decision: Decision) -> bool:
        """Check whether a decision ends the present leg, but not the trial."""
        if not isinstance(decision, Outcome) or decision not in END_OF_LEG:
            return False
        gave_up = decision is Outcome.NO_BETTER_PLAN and self.progress.state is State.STUCK
        return not gave_up and not self.leg.is_last

    def _begin_leg(self, leg: Leg) -> None:
        """Begin a leg: the path to the next way-point or the targets, or the hold.

        It has no plan yet.
        """
        self.leg = leg
        self.progress = replace(self.progress, last_plan=None, steps_driven=0)

    def _make_leg(
        self, index: int, start_s: float, start_ns: int, outcome: Outcome, poses: Poses
    ) -> Leg:
        """Create a leg: its targets, margins and obstacles, for the robots that are not lost.

        Lost robots on wheels become obstacles at their `poses`. The times, and the `outcome` of the
        previous leg, are recorded but change nothing.
        """
        present = self.estimator.present
        collision = self.section.collision
        legs = self.setup.legs
        last_index = len(legs) if self.setup.hold else len(legs) - 1
        spec_targets = legs[min(index, len(legs) - 1), present]  # a hold is at the targets
        speed = self.setup.speed[present]
        separation_min = target_separation(collision, speed, self.section.period)
        targets = spread_targets(spec_targets, separation_min)
        walls = self.setup.arena if collision.walls else None
        shapes = list(self.setup.obstacles)
        if collision.radius and self.setup.on_wheels:
            shapes += [Shape(position, collision.radius) for position in poses.xy[~present, None]]
        return Leg(
            index=index,
            is_hold=index == len(legs),
            is_last=index == last_index,
            start_s=start_s,
            start_ns=start_ns,
            outcome=outcome,
            present=present,
            targets=targets,
            discs=Discs(collision.radius, shapes, walls),
            margins=Margins(collision, shapes, walls, targets),
        )

    # a step

    def _decide(self, motion: Problem, observation: Observation) -> Decision:
        """Decide what the robots do in this step, or how the leg ends.

        `motion` is the problem with the poses that robots will have when the next command acts.
        """
        step = self._begin_step(motion)
        outcome = self._find_outcome(step, observation)
        if outcome is not None:
            return outcome
        if self.leg.is_hold and not self.setup.on_wheels:
            return self._plan_circles(step)
        if step.warm is None:
            return self._decide_at_rest(step)
        return self._decide_under_way(step, step.warm)

    def _begin_step(self, motion: Problem) -> ControlStep:
        """Collect the situation at the beginning of a control step.

        A plan may hold each signal for several control periods. The lengths of plans and the
        remaining time count from the beginning of the signal that is held now. The prediction
        contains only the rest of that signal.
        """
        section = self.section
        held_periods = self.progress.steps_driven % section.signal_periods
        rest_periods = section.signal_periods - held_periods
        first_period_s = rest_periods * section.period
        motion = replace(motion, targets=self.leg.targets, first_period=first_period_s)
        periods_left = self.time.periods_left + held_periods
        return ControlStep(
            problem=self._with_margins(motion, self.estimator.present_estimate),
            warm=self._remaining_signals(),
            horizon_max=section.horizon_max,
            signals_left=periods_left / section.signal_periods,
            values=CandidateValues(
                accept_error=section.accept_error,
                leg_time_s=self.time.elapsed_s - self.leg.start_s,
                period_s=motion.period,
                patience_s=section.patience_s(self.setup),
            ),
        )

    def _remaining_signals(self) -> Floats | None:
        """Return the rest of the plan under way, shape (L,). None if no plan is under way.

        The first signal is over when it has been held for all its periods.
        """
        last_plan = self.progress.last_plan
        if last_plan is None or last_plan.pauses:
            return None
        is_over = self.progress.steps_driven % self.section.signal_periods == 0
        return last_plan.signals[1:] if is_over else last_plan.signals

    def _find_outcome(self, step: ControlStep, observation: Observation) -> Outcome | None:
        """Return the outcome if the leg ends in this step. None if the leg continues.

        A leg ends when the robots arrive, the hold is over, the time limit is reached, or the
        controller has given up.
        """
        if self.leg.is_hold:
            assert self.setup.hold is not None
            if observation.sampled_ns - self.leg.start_ns >= self.setup.hold.seconds * SECOND:
                return self.leg.outcome
        elif self.section.arrived(step.problem.poses.distances(step.problem.targets)):
            return Outcome.ARRIVED
        if self.time.is_over:
            return Outcome.TIME_LIMIT
        if self.progress.state is State.STUCK:
            return Outcome.NO_BETTER_PLAN
        return None

    def _plan_circles(self, step: ControlStep) -> Plan:
        """Plan a hold for robots that cannot stand still: they circle within the hold's radius."""
        assert self.setup.hold is not None
        problem = replace(step.problem, within=self.setup.hold.radius)
        length = max(2, math.ceil(CircleSearch.ahead_s / problem.period))
        optimizer = self.host.wrap(CircleSearch())
        search = optimizer.search(problem, length, step.warm, self._step_key, self._limits())
        prediction = compiled_prediction(problem, search.signals)
        return replace(make_plan([search], 0, self._step_key, prediction), state=State.HOLDING)

    # under way

    def _decide_under_way(self, step: ControlStep, warm: Floats) -> Decision:
        """Decide what the robots do while they follow a plan."""
        if self.progress.state is State.PASSING and len(warm) > SIGNALS_AHEAD:
            return self._thread(step, warm)
        if self._pauses_at_end and not step.allows(min_length(step.problem)):
            return self._decide_near_time_limit(step, warm)
        stop = self._stop(step, warm, self._lower_bound_of_driving(step, warm))
        if stop is not None:
            return stop
        return self._go_on(self._search_under_way(step, warm))

    def _decide_near_time_limit(self, step: ControlStep, warm: Floats) -> Decision:
        """Decide what the robots do while they follow a plan and no time is left for a new one.

        This applies only to robots that stop at the end, because the log of an outcome has no
        searches. The plan is polished before it is compared with a stop. After a disturbance, its
        last signals may lead far from the targets, but those of the polished plan come near them.
        """
        searched = self._search_under_way(step, warm)
        best = searched.plans[0]
        stop = self._stop(step, warm, self._value(step, best), best.searches)
        if stop is not None:
            return stop
        return self._go_on(searched)

    def _lower_bound_of_driving(self, step: ControlStep, warm: Floats) -> float:
        """Compute a lower bound of the value of any plan that drives on.

        The bound is the value of the plan under way, or the value that the shortest new plan would
        have if it led exactly to the targets. A new plan counts only if there is time for it.
        """
        bound = np.inf
        if len(warm) > 0:
            bound = self._value(step, self._make_given_plan(step.problem, warm))
        if step.allows(min_length(step.problem)):
            shortest_new = len(warm) + 2  # one signal more is still the plan under way
            bound = min(bound, step.values.plan_value(0.0, shortest_new, is_new=True))
        return bound

    @property
    def _pauses_at_end(self) -> bool:
        """Whether robots that stop now should stand still for a step before the trial ends."""
        return self.leg.is_hold or (self.can_stand_still and self.leg.is_last)

    def _stop(
        self, step: ControlStep, warm: Floats, bound: float, searches: Sequence[Search] = ()
    ) -> Decision | None:
        """Stop at the best moment of the coming control period, if nothing else can be better.

        This is so if the error after the stop is at most `bound`, which is a lower bound of the
        value of any other option. Driving on would take the robots past their targets, on a detour
        that costs more than it can gain. Nothing is searched then, because a search takes up to a
        control period, and the moment would pass. (Near the time limit there are `searches`; the
        value of their best plan is `bound`.)

        On the last leg, robots that can stand still first pause. They are measured there, and the
        next step ends the leg (`_finish`) or finds a plan from where they really are. Other robots,
        and robots at a way-point, end the leg at once.
        """
        # at a way-point the next leg begins with a new plan: a later moment is not worth waiting
        within_s = self.section.period if self.leg.is_last else 0.0
        if min_error(step.problem, within_s) > bound:
            return None  # no moment can be good enough: so it is in most steps, and costs no time
        delay_ns, error = self._best_stop(step.problem, within_s)
        if error > bound:
            return None
        if self._pauses_at_end:
            pause = self._make_standstill_plan(step.problem, State.RESTING, searches)
            return replace(pause, delay_ns=delay_ns)
        outcome = Outcome.NO_BETTER_PLAN if len(warm) > 0 else Outcome.SEQUENCE_COMPLETED
        if delay_ns > 0:
            return End(outcome, delay_ns)
        return outcome

    def _best_stop(self, problem: Problem, within_s: float) -> tuple[int, float]:
        """Find the best moment to stop within a time, and the error after that stop.

        Until then, robots follow what was sent last. If a body would come near something before
        that moment, the robots stop now. The guard aborts a trial if a body would touch something
        within its reaction time, and it does not know that a stop is planned.

        Returns:
            The time until that moment [ns], and the error [length unit].
        """
        directions = self.estimator.directions_at_action
        delay_ns, error = find_best_stop(problem, directions, within_s)
        if delay_ns == 0 or not self.can_stand_still:
            return delay_ns, error
        unstopped_s = delay_ns / SECOND + REACTION_S
        if self.leg.discs.collide_if_held(problem, directions, unstopped_s):
            return find_best_stop(problem, directions, 0.0)
        return delay_ns, error

    def _go_on(self, searched: SearchResult) -> Plan:
        """Follow the plan with the lowest value that does not collide soon.

        If there is no such plan, robots pause, and the next step searches from there. Robots that
        cannot stand still follow the first plan, because nothing they could do is safer.
        """
        for plan in searched.plans:
            if not (self.can_stand_still and self._collides_soon(searched.problem, plan.signals)):
                return plan
        return self._make_standstill_plan(
            searched.problem, State.RESTING, searched.plans[0].searches
        )

    def _search_under_way(self, step: ControlStep, warm: Floats) -> SearchResult:
        """Polish the plan under way. Shorten it if it is good, otherwise search longer plans.

        While a signal is kept, the plan is followed unchanged.
        """
        if self._keeps_signal(step, warm):
            return SearchResult(step.problem, [self._make_given_plan(step.problem, warm)])
        searcher = self._make_searcher(step)
        signals = warm if len(warm) > 0 else np.zeros(1)  # robots that cannot stand need a plan
        start = signals[: max(step.signals_max, 1)]
        polished = searcher.search(len(start), start)
        assert polished is not None  # the first search is always done
        if self._is_good(polished):
            searcher.shorten(math.ceil(LENGTH_SLACK * min_length(step.problem)), self._is_good)
        else:
            self._search_longer(step, searcher, start)
        return self._search_result(step, step.problem, searcher.searches, is_from_tree=False)

    def _keeps_signal(self, step: ControlStep, warm: Floats) -> bool:
        """Check whether the present signal is kept to its end because the radio is sparse.

        If the radio is sparse, few directions reach the robots. Robots then follow a direction for
        about a whole signal period, not for the rest of one. A plan that is longer than the
        remaining time has to be searched.
        """
        is_within_signal = step.problem.first_period < step.problem.period
        fits_in_time = len(warm) <= step.signals_max
        return self.estimator.is_radio_sparse and is_within_signal and fits_in_time

    def _search_longer(self, step: ControlStep, searcher: Searcher, start: Floats) -> None:
        """Search the plan under way without its next signal, and longer plans.

        Near the end of a plan, the few signals left cannot correct what has gone wrong. Longer
        plans are searched only as long as they can have a lower value than those found. A plan that
        is only one signal longer still counts as the plan under way.
        """
        if len(start) > 1:
            searcher.search(len(start) - 1, start[1:])
        plans = self._plans_of_searches(step.problem, searcher.searches)
        value_min = min(self._value(step, plan) for plan in plans)
        for length in longer_lengths(len(start), step.signals_max):
            is_new = length > len(start) + 1
            if step.values.plan_value(0.0, length, is_new) >= value_min:
                return  # it could not win even if it led exactly to the targets
            if searcher.search(length, None if is_new else resample(start, length)) is None:
                return  # the deadline has passed
            last_index = len(searcher.searches) - 1
            newest = self._plan_of_search(step.problem, searcher.searches, last_index)
            value_min = min(value_min, self._value(step, newest))

    # under way through a passage

    def _thread(self, step: ControlStep, warm: Floats) -> Plan:
        """Continue through a narrow gap with a long plan that was made at rest.

        Only its next SIGNALS_AHEAD signals are searched again, so that they bring the robots to
        where the plan led after these signals. The other signals are kept.

        Errors of the model in the first of about 90 signals add up until the last, so the unchanged
        plan would lead robots into the wall. A search of all 90 signals would not find the path
        through the gap again. Robots pause for another plan if they stray from this one, or would
        touch something.
        """
        last_plan = self.progress.last_plan
        assert last_plan is not None
        signals_done = len(last_plan.signals) - len(warm)
        planned_poses = last_plan.path[signals_done:]  # before each signal left, and at the end
        problem = with_targets_ahead(step.problem, planned_poses)
        ahead = warm[:SIGNALS_AHEAD]
        search = self.optimizer.search(problem, len(ahead), ahead, self._step_key, self._limits())
        prediction = compiled_prediction(problem, search.signals)
        strays = self._strays(Poses.from_array(planned_poses[SIGNALS_AHEAD]), prediction.target)
        if self.can_stand_still and (strays or self._collides_soon(step.problem, search.signals)):
            return self._make_standstill_plan(step.problem, State.RESTING, [search])
        signals = np.append(search.signals, warm[SIGNALS_AHEAD:])
        plan = self._make_given_plan(step.problem, signals, [search])
        path = np.concatenate([prediction.path, planned_poses[SIGNALS_AHEAD + 1 :]])
        return replace(plan, state=State.PASSING, path=path)

    def _strays(self, planned_poses: Poses, miss: float) -> bool:
        """Check whether robots in a gap would miss their planned poses by too much.

        The next steps can correct a small miss, and the more steps are left, the larger it may be.
        So a fraction of the remaining distance is added to the limit. As before any pause, the plan
        must have been followed for a while.
        """
        driven_s = self.progress.steps_driven * self.section.period
        distance_left = float(planned_poses.distances(self.leg.targets).sum())
        limit = MISS_MAX * self.section.accept_error + MISS_FRACTION * distance_left
        return miss > limit and driven_s > FOLLOWED_MIN_S

    # at rest

    def _decide_at_rest(self, step: ControlStep) -> Plan | Outcome:
        """Decide what the robots do while no plan is under way."""
        stay = self._stay(step)
        if stay is not None:
            return stay
        finish = self._finish(step)
        if finish is not None:
            return finish
        searched = self._search_at_rest(step)
        best = searched.plans[0]
        if not (self.can_stand_still and self._collides_soon(searched.problem, best.signals)):
            return self._drive(searched, best)
        turn = self._turn(searched)
        if turn is not None:
            return turn
        return self._give_up(best)

    def _stay(self, step: ControlStep) -> Plan | None:
        """Keep standing still in a hold while all robots are within its radius.

        Driving nearer to the targets would gain nothing, and could lead the robots out of the
        radius.
        """
        distances = step.problem.poses.distances(step.problem.targets)
        if self.leg.is_hold and self.setup.hold and (distances <= self.setup.hold.radius).all():
            return self._make_standstill_plan(step.problem, State.RESTING)
        return None

    def _finish(self, step: ControlStep) -> Plan | Outcome | None:
        """End this leg of the trial, or stand still in a hold, if no new plan can gain enough.

        This applies only to robots that stand still, and only if the error is at most the lowest
        value of a new plan (the shortest plan that would lead exactly to the targets), or if there
        is no time for a new plan. Without this rule, robots would try again until the time limit.

        The first step never ends a trial, because a trial without any plan would be useless. Robots
        that are still driving, for example when a leg begins, do not end it either, because they do
        not stop where they are measured.
        """
        if self.progress.k == 0 or self.progress.is_moving:
            return None
        length = min_length(step.problem)
        length_max = max(1, step.signals_max)
        value_min = step.values.plan_value(0.0, min(length, length_max), is_new=True)
        error = float(step.problem.poses.distances(step.problem.targets).sum())
        if error > value_min and step.allows(length):
            return None
        if self.leg.is_hold:
            return self._make_standstill_plan(step.problem, State.RESTING)
        return Outcome.NO_BETTER_PLAN

    def _turn(self, searched: SearchResult) -> Plan | None:
        """Turn on the spot, for example in a corner, unless all turns have failed."""
        separation = self.section.collision.separation
        turning = self.progress.turning
        facing = choose_facing(searched.problem, self.leg.discs, separation, turning)
        if facing is None:
            return None
        searches = searched.plans[0].searches
        standing = self._make_standstill_plan(searched.problem, State.TURNING, searches)
        return replace(standing, instead=Turn(facing))

    def _give_up(self, best: Plan) -> Plan:
        """Stop, and end the trial in the next step (`_find_outcome`).

        In this way, the log contains the best plan found and all searches.
        """
        return replace(best, state=State.STUCK, instead=Stop())

    def _drive(self, searched: SearchResult, best: Plan) -> Plan:
        """Follow the best plan found.

        If a tree of directions led to it, it leads through a gap (`_thread`).

        A plan that touches something later is also followed, because the next steps search again.
        """
        if searched.is_from_tree and best.search.length > SIGNALS_AHEAD:
            return replace(best, state=State.PASSING)
        return best

    def _search_at_rest(self, step: ControlStep) -> SearchResult:
        """Search plans of increasing length until one is good.

        If none is, search from plans that a tree of directions finds: through gaps, or for many
        robots at once. A tree takes long, so robots must stand still. It also needs walls that
        bound it. Its plans may take half a minute. They keep the margins of a motion that is known
        exactly, because the motion will be identified by the time it matters, and wider margins
        would close a gap.
        """
        searcher = self._make_searcher(step)
        length_max = max(1, step.signals_max)
        problem = step.problem
        is_reached = searcher.search_lengths(min_length(problem), length_max, self._is_good)
        if is_reached or self.progress.is_moving or not self.section.collision.walls:
            return self._search_result(step, problem, searcher.searches, is_from_tree=False)
        certain_problem = self._with_margins(problem, None)
        starts = find_sequences(certain_problem, self.setup.arena, length_max, self._step_key)
        is_from_tree = searcher.search_from_starts(certain_problem, starts, self._is_good)
        searched_problem = certain_problem if is_from_tree else problem
        return self._search_result(step, searched_problem, searcher.searches, is_from_tree)

    def _is_good(self, search: Search) -> bool:
        """Check whether a plan's cost is low enough that no better plan needs to be searched."""
        return search.cost <= (self.section.optimizer.good_enough or 0.0)

    def _search_result(
        self, step: ControlStep, problem: Problem, searches: Sequence[Search], is_from_tree: bool
    ) -> SearchResult:
        """Collect the plans of all searches for a problem, the one with the lowest value first."""
        searched_step = replace(step, problem=problem)
        plans = self._plans_of_searches(problem, searches)
        plans.sort(key=lambda plan: self._value(searched_step, plan))
        return SearchResult(problem, plans, is_from_tree)

    # plans, their values, and what they might do to bodies

    @property
    def _step_key(self) -> int:
        """The key that determines all random numbers of the present control step."""
        return mix(self.key, self.progress.k)

    def _make_searcher(self, step: ControlStep) -> Searcher:
        """Create the object that runs the searches of a step. Its time limit counts from now."""
        return Searcher(self.optimizer, step.problem, self._step_key, self._limits())

    def _limits(self) -> Limits:
        """Return the time limit of the searches of this step, counted from now.

        It is the spec's `deadline` while robots drive, and SEARCH_S while they stand still.
        """
        time_limit_s = self.section.deadline if self.progress.is_moving else SEARCH_S
        end_ns = self.host.timer() + round(time_limit_s * SECOND)
        return Limits(expired=lambda _: self.host.timer() >= end_ns)

    def _plans_of_searches(self, problem: Problem, searches: Sequence[Search]) -> list[Plan]:
        """Return the plans of all searches, in the order of the searches, with predicted paths."""
        return [self._plan_of_search(problem, searches, index) for index in range(len(searches))]

    def _plan_of_search(self, problem: Problem, searches: Sequence[Search], index: int) -> Plan:
        """Return the plan of the search with this index, with its predicted path."""
        prediction = compiled_prediction(problem, searches[index].signals)
        return make_plan(searches, index, self._step_key, prediction)

    def _value(self, step: ControlStep, plan: Plan) -> float:
        """Return the value of a plan [length unit], the lower the better.

        If the cost is below the weight of an obstacle, nothing is touched, and the cost is the
        error itself. Otherwise only its part for the targets counts, plus a penalty.
        """
        error = plan.cost
        touches = False
        if plan.cost >= step.problem.obstacle_weight:
            error = plan.target_cost
            touches = plan.obstacle_cost > 0
        return step.values.plan_value(error, len(plan.signals), step.is_new(plan.signals), touches)

    def _make_given_plan(
        self, problem: Problem, signals: Floats, searches: Iterable[Search] = ()
    ) -> Plan:
        """Create a plan with given signals (L,), after `searches` that found no better one."""
        prediction = compiled_prediction(problem, signals)
        all_searches = [*searches, given_search(problem, signals, prediction)]
        return make_plan(all_searches, len(all_searches) - 1, self._step_key, prediction)

    def _make_standstill_plan(
        self, problem: Problem, state: State, searches: Iterable[Search] = ()
    ) -> Plan:
        """Create a plan that makes robots stand still.

        Its one signal is not sent; a stop or a turn is sent instead. `searches` are this step's
        searches, for the log.
        """
        plan = self._make_given_plan(problem, np.zeros(1), searches)
        return replace(plan, state=state, instead=Stop())

    def _with_margins(self, problem: Problem, estimate: Estimate | None) -> Problem:
        """Return the problem with obstacles grown by their margins.

        The margins grow with the uncertainty of the estimate. An estimate of None means that the
        motion is known exactly.
        """
        return self.leg.margins.apply(
            problem, self.section.period, self.estimator.dead_time_s, estimate
        )

    def _collides_soon(self, problem: Problem, signals: Floats) -> bool:
        """Check whether a robot would touch something before a stop can take effect.

        All robots are predicted along the first of the signals (L,), for a control period and
        STOP_DEAD_TIMES dead times. The next step may send a stop, but an error in this signal can
        no longer be corrected.
        """
        unstopped_s = self.section.period + STOP_DEAD_TIMES * self.estimator.dead_time_s
        directions = np.full(len(problem.a), signals[0])
        return self.leg.discs.collide_if_held(problem, directions, unstopped_s)

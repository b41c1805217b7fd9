"""Tests of the recommended controller: which candidate it chooses, and the states that follow.

Three m3pi robots start in a column, all facing +x. A `Scripted` optimiser finds plans whose costs
depend only on their lengths, so that the test decides which plan is good. `driving` returns a
controller whose robots are already driving. `decide` returns its decision in the next control step.
"""

import math

import numpy as np
import pytest
from testkit.hand_clock import HandClock
from testkit.scripted import STARTS, TARGETS, Scripted, mpc, observation_of
from testkit.trials import THREE_M3PI, experiment

from tetractl.control.estimation.estimator import StateEstimator
from tetractl.control.methods.fixed_sequence import given_plan
from tetractl.control.methods.lengths import (
    CUT_FRACTION,
    REST_GROWTH,
    REST_PLANS,
    SIGNALS_PER_ROBOT,
)
from tetractl.control.methods.mpc import LENGTH_SLACK, SEARCH_S
from tetractl.control.methods.value import CandidateValues
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, Steer, Stop
from tetractl.core.plan import PAUSE_S, End, Outcome, State, StopReason
from tetractl.spec.lab_section import REACTION_S

PERIOD_S = 0.2
PERIOD_NS = round(PERIOD_S * SECOND)
SPEEDS_MM_S = np.array([robot["speed"] for robot in THREE_M3PI["robots"]])
GREEN_MM_S, BLUE_MM_S, RED_MM_S = SPEEDS_MM_S.tolist()
ACCEPT = 20.0
"""Total error to accept [mm], and so the least value of a new plan, its time aside."""
BAD = 500.0
"""Cost of a plan that is not worth its time: far above ACCEPT [mm]."""
BODY = 47.0
"""Radius of an m3pi [mm]."""
SHORTEST = SIGNALS_PER_ROBOT * len(STARTS)
"""Length of the shortest plan for three robots next to their targets."""
HEARD = (True, True, True)
STRAIGHT_ON = Command(Steer(0.0), 0, HEARD)
"""The first direction, in which all robots head already; the trial's time counts from it."""
POINTS = {"walls": False, "adaptive": False, "stop_before_collision": False}
"""Robots that are points and cannot stand."""
RESTS = POINTS | {"stop_before_collision": True}
"""Robots that are points and can stand."""


def spec(collision=POINTS, sections=None, **controller):
    """The experiment with a controller of small numbers; `sections` replace others of the spec."""
    fields = {"type": "mpc", "period": PERIOD_S, "accept_error": ACCEPT, "estimate": False}
    small = {
        "horizon_max": 30,
        "time_limit": 12.2,
        "optimizer": {"type": "multistart", "tolerance": 1},
    }
    all_fields = fields | small | {"collision": collision} | controller
    return experiment(controller=all_fields, **(sections or {}))


PERIODS = 4
"""Number of control periods for which a signal is held in tests of that."""
KEPT = [(True, 1, False), (True, 3, False), (True, 4, True), (False, 1, True)]
"""Whether few directions get through, for how many steps robots have driven, and whether the next
step searches a plan: its signal is new after 4 steps."""


class Slow(Scripted):
    """An optimiser that finds BAD plans only, and takes `search_s` of the clock's time for each."""

    def __init__(self, clock, search_s):
        super().__init__(dict.fromkeys(range(100), BAD))
        self.clock = clock
        self.search_s = search_s

    def search(self, problem, length, warm, key, limits):
        self.clock.advance(self.search_s)
        return super().search(problem, length, warm, key, limits)


def put_under_way(controller, signals_left, steps=1):
    """Let robots have driven for some steps, so that so many signals of their plan are left when
    the next step begins. It alone sets the controller's progress."""
    first_signal = 1  # it is over when the step begins
    problem = controller.section.problem(controller.setup)
    plan = given_plan(problem, np.linspace(0.1, 0.3, signals_left + first_signal), 0)
    for _ in range(steps):
        controller.progress = controller.progress.with_plan(plan)


def driving_by(optimizer, signals_left=5, steps=1, clock=None, watchdog_s=None, **fields):
    """A controller of robots that have driven for some steps, so that so many signals of their plan
    are left; `optimizer` is None for the one of the spec."""
    timer = HandClock().now if clock is None else clock.now
    setup_changes = {} if watchdog_s is None else {"watchdog_s": watchdog_s}
    controller = mpc(spec(**fields), 99, optimizer, timer, **setup_changes)
    put_under_way(controller, signals_left, steps)
    return controller


def driving(costs, **fields):
    """Such a controller, and its optimiser: it finds plans of the given costs by length, else BAD
    ones."""
    search = Scripted(dict.fromkeys(range(100), BAD) | costs)
    return driving_by(search, **fields), search


def lengths(search):
    """Lengths searched, and whether each search began from the plan under way."""
    return [(length, start is not None) for length, start, *_ in search.forget()]


def decide(controller, poses=STARTS, now=PERIOD_NS, command=STRAIGHT_ON):
    """What is decided in the control step in which robots are seen at `poses`, and of which
    `command` was sent before."""
    return controller.plan(observation_of(poses, now_ns=now), command)


def good_from(shortest, cost):
    """The costs of plans by their lengths: BAD of those shorter than `shortest` signals, and `cost`
    of the others."""
    bad = dict.fromkeys(range(shortest), BAD)
    good = dict.fromkeys(range(shortest, 200), cost)
    return bad | good


def short_by(total):
    """Poses at the targets, but for green, which is `total` [mm] short of its own."""
    poses = TARGETS.copy()
    poses[0, 0] -= total
    return poses


def test_the_length_under_way_is_searched_first_and_is_enough_where_it_is_good():
    controller, search = driving({5: 0.5, 4: 0.0})
    plan = decide(controller)
    assert lengths(search) == [(5, True)]
    assert (plan.state, plan.search.length) == (State.DRIVING, 5)


def test_a_plan_within_the_accepted_error_is_followed():
    controller, search = driving({4: 30.0, 5: 15.0, 6: 30.0})
    assert decide(controller).search.length == 5
    assert max(length for length, _ in lengths(search)) == 6


@pytest.mark.parametrize(("is_sparse", "steps", "searched"), KEPT)
def test_a_signal_is_kept_to_its_end_where_few_directions_get_through(
    is_sparse, steps, searched, monkeypatch
):
    controller, search = driving({}, steps=steps, signal_periods=PERIODS)
    monkeypatch.setattr(StateEstimator, "is_radio_sparse", property(lambda _: is_sparse))
    under_way = controller.progress.last_plan.signals
    plan = decide(controller)
    assert bool(search.asked) == searched
    if not searched:
        assert np.array_equal(plan.signals, under_way)
        assert plan.state == State.DRIVING


def test_longer_plans_are_searched_afresh_where_they_can_be_worth_more():
    controller, search = driving({4: 35.0, 5: 34.0, 6: 31.0, 8: 0.0})
    assert decide(controller).search.length == 8
    lengths_asked = lengths(search)
    assert lengths_asked[:5] == [(5, True), (4, True), (6, True), (7, False), (8, False)]
    assert len(lengths_asked) == 5  # none longer can be worth as much


def test_a_good_plan_under_way_is_drawn_together_but_not_to_the_least_length():
    """Robots do not drive faster: a plan of the least length could not be mended."""
    costs = dict.fromkeys(range(100), 0.5)
    controller, search = driving(costs, signals_left=30, horizon_max=60)
    plan = decide(controller, short_by(BAD))
    asked = lengths(search)
    cut = round(CUT_FRACTION * 30)
    assert asked[:3] == [(30, True), (30 - cut, True), (30 - 2 * cut, True)]
    assert plan.search.length == math.ceil(LENGTH_SLACK * SHORTEST)
    assert all(begins_from_it for _, begins_from_it in asked)


@pytest.mark.parametrize(
    ("costs", "fields", "poses", "periods", "outcome"),
    [
        pytest.param(
            {},  # what is left of the plan leads past the targets
            {},
            short_by(ACCEPT - 5),
            1,
            Outcome.NO_BETTER_PLAN,
            id="a stop is worth most",
        ),
        pytest.param(
            {1: 0.0},
            {"signals_left": 0},
            short_by(ACCEPT - 5),
            1,
            Outcome.SEQUENCE_COMPLETED,
            id="near the targets the sequence is used up",
        ),
        pytest.param(
            {}, {"arrival_tolerance": 20}, short_by(19), 1, Outcome.ARRIVED, id="robots arrive"
        ),
        pytest.param(
            {}, {"time_limit": 2 * PERIOD_S}, STARTS, 2, Outcome.TIME_LIMIT, id="the time is over"
        ),
    ],
)
def test_the_trial_ends_where(costs, fields, poses, periods, outcome):
    controller, _ = driving(costs, **fields)
    assert decide(controller, poses, periods * PERIOD_NS) is outcome


def test_robots_whose_plan_is_used_up_far_from_their_targets_get_a_longer_one():
    """They are not stopped where they are, as if nothing were better than to follow no signal."""
    controller, search = driving({}, signals_left=0)
    search.costs |= good_from(SHORTEST, 0.0)
    plan = decide(controller, STARTS)
    assert lengths(search)[0] == (1, True)  # robots that cannot stand need a signal
    assert plan.state is State.DRIVING
    assert plan.search.length >= SHORTEST  # the shorter ones are BAD


ARRIVES_S = 0.1
MOMENTS_NS = 5_000_000
"""Time between two of the 40 moments of a period at which a stop may come."""


def arriving(**fields):
    """A controller of robots that drive along +x, have no signal left, and will all be at their
    targets in ARRIVES_S; and what it decides."""
    controller, _ = driving({}, signals_left=0, **fields)
    poses = TARGETS.copy()
    poses[:, 0] -= controller.setup.speed * ARRIVES_S
    return controller, decide(controller, poses)


@pytest.mark.parametrize(
    ("collision", "then"), [(POINTS, Outcome.SEQUENCE_COMPLETED), (RESTS, State.RESTING)]
)
def test_the_stop_comes_between_two_steps_where_that_is_best(collision, then):
    """Robots that can stand rest there."""
    _, stop = arriving(collision=collision)
    assert (stop.outcome if isinstance(stop, End) else stop.state) is then
    assert stop.delay_ns == pytest.approx(ARRIVES_S * 1e9, abs=MOMENTS_NS)


@pytest.mark.parametrize(("room", "delay_s"), [(2, ARRIVES_S), (-2, 0)])
def test_no_later_stop_is_chosen_where_it_would_bring_a_body_to_an_obstacle(room, delay_s):
    """Regression: robots that were to stop 0.2 s later drove towards an obstacle until the guard,
    which looks 0.15 s ahead, aborted the trial.

    As the guard sees it, the body of blue will reach beyond the place of the stop, its target, by
    its radius and the way in the time to react. An obstacle there leaves `room` [mm]. A stop at
    once leaves all robots ARRIVES_S short of their targets, which is accepted.
    """
    x, y = TARGETS[1, :2]
    reach = BODY + BLUE_MM_S * REACTION_S
    short_of_targets = SPEEDS_MM_S.sum() * ARRIVES_S
    box = {"left": x + reach + room, "bottom": y - 50, "width": 100, "height": 100}
    obstacles = [{"type": "rectangle"} | box]
    bodies = RESTS | {"radius": BODY}
    _, rest = arriving(
        collision=bodies, sections={"obstacles": obstacles}, accept_error=short_of_targets + 5
    )
    assert rest.state is State.RESTING
    assert rest.delay_ns == pytest.approx(delay_s * 1e9, abs=MOMENTS_NS)


STOPPED_NS = PERIOD_NS + PERIOD_NS // 2
NEW_PLAN_VALUE = CandidateValues(ACCEPT, leg_time_s=1.0, period_s=PERIOD_S).plan_value(
    0.0, SHORTEST, is_new=True
)
"""Value of this plan 1 s after the beginning if it leads exactly to the targets [mm]."""


@pytest.mark.parametrize(
    ("total", "time_limit", "then"),
    [
        (NEW_PLAN_VALUE - 1, 12.2, Outcome.NO_BETTER_PLAN),
        (NEW_PLAN_VALUE + 1, 12.2, State.DRIVING),
        (NEW_PLAN_VALUE + 1, 1.0 + (SHORTEST - 1) * PERIOD_S, Outcome.NO_BETTER_PLAN),
    ],
)
def test_after_a_rest_the_trial_ends_unless_a_new_plan_can_be_better_in_time(
    total, time_limit, then
):
    """One second after the beginning, robots are seen to stand `total` [mm] off."""
    controller, _ = arriving(collision=RESTS, time_limit=time_limit)
    controller.optimizer.costs = good_from(SHORTEST, 0.0)
    stopped = Command(Stop(), STOPPED_NS, HEARD)
    decision = decide(controller, short_by(total), now=SECOND, command=stopped)
    assert (decision if isinstance(decision, Outcome) else decision.state) is then


def beside_a_wall(gap, stop=True, radius=0.0, **fields):
    """A controller of robots of which green drives straight to the right wall, `gap` [mm] from it;
    and their poses."""
    collision = POINTS | {"walls": True, "radius": radius, "stop_before_collision": stop}
    controller = driving_by(None, signals_left=1, collision=collision, **fields)
    poses = STARTS.copy()
    poses[0, 0] = controller.setup.arena.right - gap
    return controller, poses


def test_robots_stop_and_turn_on_the_spot_rather_than_leave_where_every_plan_does():
    """Green stops 5 mm from the wall that it faces."""
    controller, poses = beside_a_wall(5)
    stop = decide(controller, poses)
    standing_ns = PERIOD_NS + round(PAUSE_S * SECOND)  # a step without driving takes as long
    stopped = Command(stop.action, PERIOD_NS, HEARD)
    turn = decide(controller, poses, PERIOD_NS + standing_ns, stopped)
    assert (stop.state, turn.state) == (State.RESTING, State.TURNING)
    assert len(turn.searches) > 1  # from standing nothing could move safely
    assert math.cos(turn.action.facing) < 0.1  # not towards the right wall


def test_robots_that_gave_up_and_are_found_at_their_way_points_go_on(monkeypatch):
    """Regression: the trial ended as arrived, far from the targets."""
    monkeypatch.setattr("tetractl.control.methods.mpc.choose_facing", lambda *_: None)
    robots = [robot | {"via": [robot["start"]]} for robot in THREE_M3PI["robots"]]
    controller, poses = beside_a_wall(5, arrival_tolerance=5, sections={"robots": robots})
    stop = decide(controller, poses)
    stopped = Command(stop.action, PERIOD_NS, HEARD)
    stuck = decide(controller, poses, 5 * PERIOD_NS, stopped)
    assert stuck.state is State.STUCK
    stopped_again = Command(stuck.action, 5 * PERIOD_NS, HEARD)
    at_the_way_points = STARTS
    plan = decide(controller, at_the_way_points, 9 * PERIOD_NS, stopped_again)
    assert plan.leg == 1


@pytest.mark.parametrize(
    ("gap", "radius", "can_stand", "state"),
    [
        (5, 0, True, State.RESTING),
        (-30, 0, True, State.RESTING),
        (52, 47, True, State.RESTING),
        (30, 47, True, State.RESTING),
        (30, 0, False, State.DRIVING),
    ],
)
def test_robots_that_can_stand_stop_before_a_body_touches_a_wall_or_goes_deeper(
    gap, radius, can_stand, state
):
    controller, poses = beside_a_wall(gap, can_stand, radius)
    assert decide(controller, poses).state is state


def test_a_first_plan_that_leads_a_body_into_a_wall_is_not_driven():
    """Regression: green, 5 mm of room before it, came to 21 mm from the edge with its centre."""
    in_a_room = spec(collision={"radius": BODY, "stop_before_collision": True}, horizon_max=6)
    poses = STARTS.copy()
    poses[0] = [in_a_room.setup.arena.left + BODY + 5, 800, math.pi]
    assert mpc(in_a_room, 99).plan(observation_of(poses)).state is State.TURNING


RED_WAY = float(np.hypot(*(TARGETS - STARTS)[2, :2]))
STRAIGHT = math.ceil(RED_WAY / RED_MM_S / PERIOD_S)
"""Length of the shortest plan that is searched from the starts: red, which takes longest, drives
straight to its target."""
FIRST = round(REST_GROWTH * STRAIGHT)
"""Length of the plan that is searched first: several robots hardly ever all drive straight."""


@pytest.mark.parametrize(
    "shortest", [STRAIGHT - 4, STRAIGHT, STRAIGHT + 1, STRAIGHT + 3, FIRST + 2, 2 * STRAIGHT]
)
def test_the_first_plan_is_the_shortest_that_is_good_enough(shortest):
    search = Scripted(good_from(shortest, 0.5))
    with_time = spec(horizon_max=100, time_limit=80.2)  # for long plans
    plan = mpc(with_time, 99, search).plan(observation_of())
    lengths_asked = [length for length, *_ in search.asked]
    assert lengths_asked[0] == FIRST
    assert plan.search.length == max(STRAIGHT, shortest)
    assert min(lengths_asked) >= STRAIGHT


def test_a_leg_that_begins_within_a_signal_holds_its_first_signal_for_all_its_periods():
    """Regression: the first signal was planned for what was left of the signal before."""
    search = Scripted()
    robots = [robot | {"via": [robot["start"]]} for robot in THREE_M3PI["robots"]]
    fields = {"signal_periods": 2, "arrival_tolerance": 5}
    controller = mpc(spec(sections={"robots": robots}, **fields), 99, search)
    away = STARTS - np.array([50.0, 0, 0])
    first = decide(controller, away, now=0, command=None)
    assert first.leg == 0
    at_the_way_point = STARTS  # reached within the first signal
    plan = decide(controller, at_the_way_point, command=Command(first.action, 0, HEARD))
    assert plan.leg == 1
    first_way = np.hypot(*(plan.path[1, :, :2] - plan.path[0, :, :2]).T)
    assert first_way == pytest.approx(controller.setup.speed * 2 * PERIOD_S, rel=0.05)


@pytest.mark.parametrize(
    ("search_s", "searches"), [(0.0, 3 * REST_PLANS), (0.6 * SEARCH_S, 2), (1.1 * SEARCH_S, 1)]
)
def test_searches_for_standing_robots_end_after_a_second(search_s, searches):
    """No plan is good: with enough time, three lengths up to the longest are four times each.
    The turn that follows is given."""
    clock = HandClock()
    optimizer = Slow(clock, search_s)
    longest = round(REST_GROWTH * FIRST) + 1  # the third length
    standing = spec(collision=RESTS, horizon_max=longest, time_limit=40.2)
    controller = mpc(standing, 99, optimizer, timer=clock.now)
    plan = controller.plan(observation_of())
    done = [search for search in plan.searches if search.stopped is not StopReason.FIXED]
    assert len(done) == searches


@pytest.mark.parametrize(("cost", "state"), [(1.0, State.DRIVING), (BAD, State.RESTING)])
def test_near_the_limit_a_stop_is_compared_with_the_polished_plan(cost, state):
    """Regression: with no time left for a new plan, robots stopped if that was better than the
    plan under way as it was, though polished it would have led them to their targets.

    The signals left lead the robots, ACCEPT + 30 short of their targets, far past them.
    """
    controller, search = driving({5: cost}, time_limit=2, collision=RESTS)
    assert controller.section.time_limit < SHORTEST * PERIOD_S
    plan = decide(controller, short_by(ACCEPT + 30))
    assert plan.state is state
    searched = [len(found.signals) for found in plan.searches if found.stopped != StopReason.FIXED]
    assert searched == [length for length, _ in lengths(search)]  # the log has all of them


def test_robots_stop_before_the_arc_of_a_signal_touches_a_wall_its_ends_do_not():
    """Regression: a body went 0.6 mm over the edge by a plan whose obstacle cost was 0."""
    bodies = RESTS | {"walls": True, "radius": BODY, "margin": 0}
    controller, _ = driving({5: 0.0}, collision=bodies)
    poses = STARTS.copy()
    poses[0] = [800, controller.setup.arena.bottom + BODY + 0.1, -0.06]
    assert decide(controller, poses).state is State.RESTING


def test_robots_that_cannot_stand_drive_on_where_their_plan_is_longer_than_the_time_left():
    """Regression: after a late step no plan was searched, and robots that cannot stand stopped."""
    signals_in_time = 2
    now_ns = 10 * PERIOD_NS
    time_limit = now_ns / 1e9 + signals_in_time * PERIOD_S
    controller, _ = driving({signals_in_time: ACCEPT}, signals_left=9, time_limit=time_limit)
    plan = decide(controller, now=now_ns)
    assert (plan.state, plan.search.length) == (State.DRIVING, signals_in_time)

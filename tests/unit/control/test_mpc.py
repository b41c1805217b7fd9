"""The recommended controller: which candidate is chosen, and the states it leads to."""

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.scripted import STARTS, TARGETS, Scripted, mpc, seen
from support.trials import experiment

from tetractl.control.evaluate import compiled_foresee
from tetractl.control.fixed_sequence import given_plan
from tetractl.control.lengths import VAIN
from tetractl.control.margins import Margins
from tetractl.control.mpc import ControlStep, Leg, TrialProgress
from tetractl.control.value import Worth
from tetractl.core.commands import Command, Steer, Stop
from tetractl.core.plan import End, Outcome, Plan, State, StopReason
from tetractl.core.poses import Poses
from tetractl.core.shape import Shape

ACCEPT = 20.0
POINTS = {"walls": False, "adaptive": False, "stop_before_collision": False, "silence": 0}


def spec(collision=POINTS, **controller):
    fields = {"type": "mpc", "period": 0.2, "accept_error": ACCEPT, "estimate": False}
    small = {
        "horizon_max": 30,
        "time_limit": 12.2,
        "optimizer": {"type": "multistart", "tolerance": 1},
    }
    return experiment(controller=fields | small | {"collision": collision} | controller)


def driving(costs, left=5, **fields):
    """A controller of robots under way by a plan of `left` + 1 signals, and its optimiser, which
    finds plans of the given costs by length."""
    search = Scripted(dict.fromkeys(range(100), 500.0) | {left + 1: 0.0})
    controller = mpc(spec(**fields), 99, search)
    controller.time.seen(seen(STARTS), Command(Steer(0.0), 0, (True,) * 3))
    controller.progress = under_way(first(controller, left + 1))
    search.costs = dict.fromkeys(range(100), 500.0) | costs
    search.forget()
    return controller, search


def under_way(plan, steps=1):
    """What a controller keeps after so many steps by a plan on the only leg."""
    return TrialProgress(Leg(0, 0.0, 0, False, Outcome.ARRIVED), k=steps, last=plan, began=0)


def first(controller, length):
    """A plan of so many signals for robots at their starts."""
    problem = controller.section.problem(controller.setup)
    return given_plan(problem, np.linspace(0.1, 0.3, length), 0)


def lengths(search):
    """Lengths searched, and whether each began from the plan under way."""
    return [(length, start is not None) for length, start, *_ in search.forget()]


def step(controller, poses=STARTS, now=200_000_000):
    return controller.plan(seen(poses, now=now))


def near(total):
    poses = TARGETS.copy()
    poses[0, 0] -= total
    return poses


def test_the_length_under_way_is_searched_first_and_is_enough_where_it_is_good():
    controller, search = driving({5: 0.5, 4: 0.0})
    plan = step(controller)
    assert lengths(search) == [(5, True)]
    assert (plan.state, plan.search.length) == (State.DRIVING, 5)


def test_of_plans_about_as_long_the_one_of_least_value_is_followed():
    controller, search = driving({4: 8.0, 5: 9.0, 6: 7.0})
    assert step(controller).search.length == 6
    assert lengths(search)[:3] == [(5, True), (4, True), (6, True)]


def test_a_plan_within_the_accepted_error_is_followed():
    controller, search = driving({4: 30.0, 5: 15.0, 6: 30.0})
    assert step(controller).search.length == 5
    assert max(length for length, _ in lengths(search)) == 6


def test_longer_plans_are_searched_afresh_where_they_can_be_worth_more():
    controller, search = driving({4: 35.0, 5: 34.0, 6: 31.0, 8: 0.0})
    assert step(controller).search.length == 8
    asked = lengths(search)
    assert asked[:5] == [(5, True), (4, True), (6, True), (7, False), (8, False)]
    assert len(asked) == 5  # none longer can be worth as much


@pytest.mark.parametrize(("periods", "tried"), [(1, [5, 4, 6, 7, 8]), (2, [5])])
def test_no_plan_is_longer_than_the_steps_that_are_left(periods, tried):
    controller, search = driving({}, time_limit=2, signal_periods=periods)
    step(controller)
    assert [length for length, _ in lengths(search)] == tried


def test_longer_plans_are_searched_on_where_the_deadline_came_between():
    controller, search = driving({}, deadline=0.075)
    time = iter(range(0, 10**12, 10_000_000))
    controller.timer = lambda: next(time)
    step(controller)
    first = [length for length, _ in lengths(search)]
    step(controller, now=400_000_000)
    second = [length for length, _ in lengths(search)]
    assert first[:4] == [5, 4, 6, 7]
    assert second[3] > first[-1]


def test_the_trial_ends_where_a_stop_is_worth_most():
    """What is left of the plan leads past the targets."""
    controller, _ = driving({})
    assert step(controller, near(15)) is Outcome.NO_BETTER_PLAN


def test_robots_too_far_off_go_on_though_the_sequence_is_used_up():
    controller, _ = driving({1: 0.0}, left=0)
    assert isinstance(step(controller, near(35)), Plan)
    controller, _ = driving({1: 0.0}, left=0)
    assert step(controller, near(15)) is Outcome.SEQUENCE_COMPLETED


def test_arrival_and_the_last_step_end_a_trial():
    controller, _ = driving({}, arrival_tolerance=20)
    assert step(controller, near(19)) is Outcome.ARRIVED
    controller, _ = driving({}, time_limit=0.4)
    assert step(controller, now=400_000_000) is Outcome.TIME_LIMIT


def along_x(collision, time_limit=12.2, beyond=None):
    """Robots that all drive along +x with an empty plan: blue is 200 mm/s fast and 20 mm short of
    its target, so that all are there in 0.1 s. An obstacle may be `beyond` it."""
    controller, _ = driving({}, left=0, collision=collision, time_limit=time_limit)
    if beyond is not None:
        margins = Margins([beyond], None, TARGETS[:, :2], 47)
        controller.course = replace(controller.course, margins=margins)
    controller.estimator.sent(Command(Steer(0.0), 0, (True,) * 3))
    poses = TARGETS.copy()
    poses[:, 0] -= [18, 20, 15]
    return controller, step(controller, poses)


def test_the_stop_comes_between_two_steps_where_that_is_best():
    _, ended = along_x(POINTS)
    assert isinstance(ended, End)
    assert ended.outcome is Outcome.SEQUENCE_COMPLETED
    assert ended.delay_ns == pytest.approx(100_000_000, abs=3_000_000)


RESTS = POINTS | {"stop_before_collision": True}


@pytest.mark.parametrize(("gap", "delay_ms"), [(79, 100), (75, 0)])
def test_no_later_stop_is_chosen_where_it_would_bring_a_body_to_an_obstacle(gap, delay_ms):
    """Regression: robots that were to stop 0.2 s later drove towards an obstacle until the guard,
    which looks 30 mm ahead, aborted the trial."""
    box = np.array([[0, -50], [100, -50], [100, 50], [0, 50]])
    beyond = np.array([TARGETS[1, 0] + gap, TARGETS[1, 1]])
    _, rest = along_x(RESTS, beyond=Shape(box + beyond))
    assert rest.delay_ns == pytest.approx(delay_ms * 1e6, abs=3_000_000)


@pytest.mark.parametrize(
    ("total", "time_limit", "then"),
    [
        (19, 12.2, Outcome.NO_BETTER_PLAN),
        (35, 12.2, State.DRIVING),
        (35, 1.4, Outcome.NO_BETTER_PLAN),
    ],
)
def test_robots_that_can_stand_rest_and_then_end_or_go_on(total, time_limit, then):
    controller, rest = along_x(RESTS, time_limit)
    assert rest.state is State.RESTING
    assert rest.delay_ns == pytest.approx(100_000_000, abs=3_000_000)
    controller.estimator.sent(Command(Stop(), 300_000_000, (True,) * 3))
    controller.optimizer = Scripted(
        {length: 0.0 if length > 17 else 500.0 for length in range(100)}
    )
    decision = step(controller, near(total), now=1_000_000_000)
    assert (decision if isinstance(decision, Outcome) else decision.state) is then


@pytest.mark.parametrize(("steps", "state"), [(9, State.DRIVING), (11, State.RESTING)])
def test_robots_rest_for_a_better_plan_once_they_have_driven_for_two_seconds(steps, state):
    controller, _ = driving({}, collision=RESTS)
    controller.progress = under_way(controller.progress.last, steps)
    assert step(controller).state is state


@pytest.mark.parametrize(("length", "tested"), [(2, None), (3, 1), (5, 2), (6, 2), (7, 5)])
@pytest.mark.parametrize(("watchdog_s", "seconds"), [(math.inf, 0.8), (0.5, 0.5)])
def test_the_next_signals_of_a_plan_are_to_be_safe_and_nearly_all_of_a_new_one(
    length, tested, watchdog_s, seconds
):
    """The plan under way has 5 signals left, so that one of 7 is new."""
    controller, _ = driving({}, collision=POINTS | {"silence": 0.6})
    controller.setup = replace(controller.setup, watchdog_s=watchdog_s)
    asked = []
    now = controller._step(controller.estimator.seen(seen()))

    def clear_unheard(problem, path, signals, seconds, margin, apart):
        asked.append((len(signals), pytest.approx(seconds)))

    margins = SimpleNamespace(clear_unheard=clear_unheard)
    controller.course = replace(controller.course, margins=margins)
    signals = np.zeros(length)
    controller._safe(now, signals, compiled_foresee(now.problem, signals))
    assert asked == ([] if tested is None else [(tested, seconds)])


def beside_a_wall(gap, stop=True, radius=0.0, **fields):
    """A controller of robots of which green drives towards the right wall, 36 mm in a period, and
    no plan keeps clear."""
    collision = POINTS | {"walls": True, "radius": radius, "stop_before_collision": stop}
    controller, _ = driving({}, collision=collision, **fields)
    controller.optimizer = controller.section.optimizer
    controller.progress = under_way(first(controller, 2))
    controller.estimator.sent(Command(Steer(0.0), 0, (True,) * 3))
    poses = STARTS.copy()
    poses[0, 0] = controller.setup.arena.right - gap
    return controller, poses


def decisions_beside_a_wall(count):
    """The decisions from the stop on, with green where it stopped."""
    controller, poses = beside_a_wall(5)
    found, command = [], None
    for k in range(count):
        now = 200_000_000 + k * 700_000_000
        found.append(controller.plan(seen(poses, now=now), command, ()))
        command = Command(getattr(found[-1], "action", Stop()), now, (True,) * 3)
    return found


def test_robots_stop_and_turn_on_the_spot_rather_than_leave_where_every_plan_does():
    stop, turn = decisions_beside_a_wall(2)
    assert (stop.state, turn.state) == (State.RESTING, State.TURNING)
    assert len(turn.searches) > 1  # from standing nothing could move safely
    assert math.cos(turn.action.facing) < 0.1  # not towards the right wall


def test_a_trial_ends_after_a_step_where_no_turn_helps(monkeypatch):
    monkeypatch.setattr("tetractl.control.mpc.next_facing", lambda *_: None)
    stop, stuck, end = decisions_beside_a_wall(3)
    assert (stop.state, stuck.state) == (State.RESTING, State.STUCK)
    assert stuck.pauses
    assert stuck.evaluations > 1000  # the log holds them
    assert end is Outcome.NO_BETTER_PLAN


def test_robots_in_a_corner_turn_before_they_search_thoroughly():
    """A search that hops a thousand times takes long, and finds nothing."""
    _, turn = decisions_beside_a_wall(2)
    assert turn.evaluations < 10_000


@pytest.mark.parametrize(("gap", "radius"), [(5, 0), (-30, 0), (52, 47), (30, 47)])
def test_robots_stop_before_a_body_touches_a_wall_or_goes_deeper(gap, radius):
    controller, poses = beside_a_wall(gap, radius=radius)
    assert step(controller, poses).state is State.RESTING


@pytest.mark.parametrize(("gap", "enters"), [(70, True), (75, False)])
def test_a_stop_that_is_lost_once_acts_after_two_dead_times(gap, enters):
    """Green drives 72 mm in a period and two dead times."""
    controller, poses = beside_a_wall(gap, dead_time=0.1)
    problem = replace(controller.estimator.problem, poses=Poses.of(poses))
    assert controller._enters(problem, np.zeros(1)) is enters


def test_robots_stop_before_the_arc_of_a_signal_touches_a_wall_its_ends_do_not():
    """Regression: a body went 0.6 mm over the edge by a plan whose obstacle cost was 0."""
    collision = {"radius": 47, "margin": 0, "adaptive": False, "silence": 0}
    controller, _ = driving({5: 0.0}, collision={"stop_before_collision": True} | collision)
    poses = STARTS.copy()
    poses[0] = [800, controller.setup.arena.bottom + 47.1, -0.06]
    assert step(controller, poses).state is State.RESTING


def test_robots_that_cannot_stand_drive_on():
    controller, poses = beside_a_wall(30, stop=False)
    assert step(controller, poses).state is State.DRIVING


def test_a_first_plan_that_leads_a_body_into_a_wall_is_not_driven():
    """Regression: green, 5 mm of room before it, came to 21 mm from the edge with its centre."""
    one = spec(collision={"radius": 47, "stop_before_collision": True}, horizon_max=6)
    poses = STARTS.copy()
    poses[0] = [one.setup.arena.left + 52, 800, math.pi]
    assert mpc(one, 99).plan(seen(poses)).state is State.TURNING


@pytest.mark.parametrize("turns", [True, False])
def test_a_first_plan_on_whose_way_a_body_touches_a_wall_is_driven_after_turns_in_vain(
    turns, monkeypatch
):
    """Regression: it was driven at once if a stop could still act before the wall. Green would
    touch it with the fourth signal."""
    one = spec(collision={"radius": 47, "stop_before_collision": True}, horizon_max=6)
    poses = STARTS.copy()
    poses[0] = [one.setup.arena.right - 147, 800, 0]
    if not turns:
        monkeypatch.setattr("tetractl.control.mpc.next_facing", lambda *_: None)
    plan = mpc(one, 99, Scripted()).plan(seen(poses))
    assert plan.state is (State.TURNING if turns else State.DRIVING)


@pytest.mark.parametrize("shortest", [26, 30, 31, 33, 41, 60])
def test_the_first_plan_is_the_shortest_that_is_good_enough(shortest):
    """Red has the longest way: 894 mm at 150 mm/s are 30 signals, which no search begins with."""
    search = Scripted(
        dict.fromkeys(range(shortest), 500.0) | dict.fromkeys(range(shortest, 200), 0.5)
    )
    plan = mpc(spec(horizon_max=100, time_limit=80.2), 99, search).plan(seen())
    asked = [length for length, *_ in search.asked]
    assert asked[0] == 39
    assert plan.search.length == max(30, shortest)
    assert min(asked) >= 30


class Lucky(Scripted):
    """An optimiser that finds a plan of 34 signals at its second try only, as one may by chance."""

    def search(self, problem, length, warm, key, limits):
        tries = sum(length == before for before, *_ in self.asked)
        self.costs[length] = 0.5 if length >= 39 or (length == 34 and tries == 1) else 500.0
        return super().search(problem, length, warm, key, limits)


def test_a_length_that_failed_is_searched_again_with_other_random_numbers():
    search = Lucky()
    plan = mpc(spec(horizon_max=100, time_limit=80.2), 99, search).plan(seen())
    assert plan.search.length == 34
    keys = [key for length, _, key, _ in search.asked if length == 34]
    assert len(keys) >= 2 and len(set(keys)) == len(keys)


def test_searches_for_a_shorter_plan_end_after_vain_ones():
    search = Scripted(dict.fromkeys(range(39), 500.0) | dict.fromkeys(range(39, 200), 0.5))
    mpc(spec(horizon_max=100, time_limit=80.2), 99, search).plan(seen())
    assert len(search.asked) == 1 + VAIN  # the first is good, and no shorter one is


def test_spread_lengths_end_with_the_horizon():
    search = Scripted()
    mpc(spec(horizon_max=40), 99, search).plan(seen())
    asked = [length for length, *_ in search.asked]
    assert asked[:2] == [39, 40]
    assert max(asked) == 40  # also of those that are searched thoroughly then


def test_a_leg_that_begins_within_a_signal_holds_its_first_signal_for_all_its_periods():
    """Regression: the first signal was planned for what was left of the signal before."""
    search = Scripted()
    controller = mpc(spec(signal_periods=2, arrival_tolerance=5), 99, search)
    legs = np.stack([STARTS[:, :2], TARGETS[:, :2]])
    controller.legs = replace(controller.setup, way_points=legs[:1]).legs
    controller._begin(controller.progress.leg, controller.setup.starts)
    away = STARTS - np.array([50.0, 0, 0])
    assert step(controller, away).leg == 0
    plan = step(controller)
    assert plan.leg == 1
    way = np.hypot(*(plan.path[1, :, :2] - plan.path[0, :, :2]).T)
    assert way == pytest.approx(controller.setup.speed * 0.4, rel=0.05)


@pytest.mark.parametrize(("wait_s", "allowed"), [(0.0, True), (0.4, True), (0.5, False)])
def test_a_rest_leaves_time_for_the_plan_after_it(wait_s, allowed):
    problem = spec().controller.problem(spec().setup)
    now = ControlStep(problem, None, 30, 20.0, Worth(ACCEPT, 0.0, problem.period))
    assert now.allows(18, wait_s) == allowed


def test_a_target_farther_away_than_the_longest_plan_leads_leaves_time_for_it():
    problem = spec().controller.problem(spec().setup)
    now = ControlStep(problem, None, 12, 400.0, Worth(ACCEPT, 0.0, problem.period))
    assert now.allows(51, 0.0) and now.signals_max == 12


@pytest.mark.parametrize(("look_s", "searches"), [(0.0, 3), (0.6, 2), (1.1, 1)])
def test_searches_for_standing_robots_end_after_a_second(look_s, searches):
    """Each look at the timer takes `look_s`; no plan is good. The turn that follows is given."""
    search = Scripted(dict.fromkeys(range(100), 2500.0))
    controller = mpc(spec(collision=RESTS, horizon_max=60, time_limit=40.2), 99, search)
    looks = itertools.count(step=round(look_s * 1e9))
    controller.timer = lambda: next(looks)
    done = [one for one in controller.plan(seen()).searches if one.stopped is not StopReason.FIXED]
    assert len(done) == searches

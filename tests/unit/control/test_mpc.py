import math
from dataclasses import replace

import numpy as np
import pytest
from support.trials import experiment

from tetractl.control import mpc as mpc_module
from tetractl.control.rng import mix
from tetractl.core.commands import Command
from tetractl.core.plan import End, Outcome, Plan, Search, StopReason
from tetractl.core.poses import Observation, Poses
from tetractl.experiment.controller import same

STARTS = np.array([[900.0, 800, 0], [900, 1200, 0], [900, 1600, 0]])
TARGETS = np.array([[1700.0, 500, 0], [1700, 1500, 0], [1700, 2000, 0]])


def spec(**controller):
    fields = {"horizon_max": 6, "optimizer": {"particles": 5, "iterations": 3}}
    return experiment(controller=fields | controller)


def seen(poses=STARTS, now=0):
    count = len(poses)
    return Observation(0, now, now, Poses.of(np.array(poses)), np.ones(count, np.bool_))


def mpc(experiment, key, optimizer=None):
    wrap = same if optimizer is None else lambda _: optimizer
    return experiment.controller.build(experiment.setup, key, wrap)


class Scripted:
    """An optimiser that writes down what it was asked and answers with costs by length."""

    def __init__(self, costs=None, evaluations=10):
        self.costs = costs or {}
        self.evaluations = evaluations
        self.asked = []

    def search(self, problem, length, warm, key, limits):
        start = None if warm is None else warm.tolist()
        self.asked.append((length, start, key, limits.evaluations))
        cost = self.costs.get(length, 100.0 + length)
        signals = np.arange(1, length + 1) / 10 + len(self.asked) / 1000
        return Search(
            length, signals, cost, np.array([cost]), self.evaluations, StopReason.ITERATIONS
        )

    def forget(self):
        asked, self.asked = self.asked, []
        return asked


def test_step_0_tries_every_horizon_from_nothing_and_takes_the_best():
    search = Scripted({4: 7.0})
    plan = mpc(spec(), 99, search).plan(seen())
    assert isinstance(plan, Plan)
    assert [(length, warm) for length, warm, *_ in search.asked] == [(n, None) for n in range(1, 7)]
    assert (plan.chosen, plan.search.length, plan.cost) == (3, 4, 7.0)
    assert plan.signals is plan.searches[3].signals
    assert len(plan.searches) == 6
    assert plan.evaluations == 60


def test_of_equal_costs_the_first_is_taken():
    search = Scripted({3: 7.0, 5: 7.0})
    plan = mpc(spec(), 99, search).plan(seen())
    assert isinstance(plan, Plan)
    assert plan.search.length == 3


def test_later_steps_try_one_less_as_many_and_one_more_from_the_warm_start():
    """Algorithm 2, lines 10-21; u_(warm) is u_(opt) without its first signal."""
    search = Scripted({4: 7.0})
    controller = mpc(spec(), 99, search)
    first = controller.plan(seen())
    assert isinstance(first, Plan)
    warm = first.signals[1:].tolist()
    search.forget()
    search.costs = {2: 3.0}
    second = controller.plan(seen(now=200_000_000))
    assert isinstance(second, Plan)
    assert [(length, start) for length, start, *_ in search.forget()] == [
        (2, warm[1:]),  # H - 1 = 2: without its first signal
        (3, warm),
        (4, [*warm, 0.0]),
    ]
    controller.plan(seen(now=400_000_000))  # H = 1: a sequence of no signals cannot be searched
    warm = second.signals[1:].tolist()
    assert [(length, start) for length, start, *_ in search.forget()] == [
        (1, warm),
        (2, [*warm, 0.0]),
    ]


def lengths_asked(costs, good_enough):
    """Lengths searched at step 0 and at the next step, where an optimiser has a tolerance."""
    search = Scripted(dict.fromkeys(range(1, 7), 50.0) | costs[0])
    optimizer = {"type": "multistart", "tolerance": good_enough}
    controller = mpc(spec(optimizer=optimizer), 99, search)
    controller.plan(seen())
    first = [length for length, *_ in search.forget()]
    search.costs |= costs[1]
    plan = controller.plan(seen(now=200_000_000))
    assert isinstance(plan, Plan)
    return first, [length for length, *_ in search.forget()], plan.search.length


def test_lengths_that_could_not_be_chosen_are_not_searched():
    """Among good ones step 0 takes the shortest, and later steps the length under way."""
    assert lengths_asked(({4: 1.0}, {3: 1.0}), 1.0) == ([1, 2, 3, 4], [3], 3)


def test_one_less_is_searched_before_one_more():
    assert lengths_asked(({4: 1.0}, {2: 0.5, 3: 2.0, 4: 0.1}), 1.0)[1:] == ([3, 2], 2)
    assert lengths_asked(({4: 1.0}, {2: 1.5, 3: 2.0, 4: 0.1}), 1.0)[1:] == ([3, 2, 4], 4)


def test_a_length_that_is_not_accepted_does_not_end_the_step():
    search = Scripted({4: 0.5})
    optimizer = {"type": "multistart", "tolerance": 1.0}
    controller = mpc(spec(optimizer=optimizer, accept_error=0.2), 99, search)
    controller.plan(seen())
    search.forget()
    search.costs |= {3: 0.5, 2: 0.1}
    assert isinstance(controller.plan(seen(now=200_000_000)), Plan)
    assert [length for length, *_ in search.forget()] == [3, 2]


def test_where_none_is_good_the_least_cost_is_taken():
    assert lengths_asked(({4: 1.0}, {2: 1.5, 3: 2.0, 4: 1.6}), 1.0)[1:] == ([3, 2, 4], 2)


def test_horizons_may_outgrow_horizon_max():
    search = Scripted({n: 100.0 - n for n in range(20)})
    controller = mpc(spec(), 99, search)
    lengths = [controller.plan(seen(now=k)).search.length for k in range(5)]
    assert lengths == [6, 6, 6, 6, 6]  # H + 1 = 5 + 1
    assert [length for length, *_ in search.asked[-3:]] == [4, 5, 6]


def test_draws_come_from_the_key_the_step_and_the_length():
    search = Scripted({n: 100.0 - n for n in range(20)})
    controller = mpc(spec(), 99, search)
    keys = set()
    for k in range(3):
        plan = controller.plan(seen())
        assert isinstance(plan, Plan)
        assert plan.generator == mix(99, k)
        for length, _, key, _ in search.forget():
            assert key == mix(mix(99, k), length)
            keys.add(key)
    assert len(keys) == 6 + 3 + 3


def test_a_used_up_sequence_is_the_outcome():
    search = Scripted({1: 0.0})
    controller = mpc(spec(), 99, search)
    assert isinstance(controller.plan(seen()), Plan)
    assert controller.plan(seen()) is Outcome.SEQUENCE_COMPLETED


def test_arrival_means_every_robot_within_the_tolerance():
    near = TARGETS.copy()
    near[:, 0] += [20, -20, 0]
    near[2, 1] += 20.001
    controller = mpc(spec(arrival_tolerance=20), 99, Scripted())
    assert isinstance(controller.plan(seen(near)), Plan)
    near[2, 1] = 2020
    assert controller.plan(seen(near)) is Outcome.ARRIVED


def test_a_tolerance_of_0_never_ends_a_trial():
    plan = mpc(spec(arrival_tolerance=0), 99, Scripted()).plan(seen(TARGETS))
    assert isinstance(plan, Plan)


def test_arrival_comes_before_the_other_ends():
    controller = mpc(spec(arrival_tolerance=20, steps_max=1), 99, Scripted({1: 0.0}))
    assert isinstance(controller.plan(seen()), Plan)
    assert controller.plan(seen(TARGETS)) is Outcome.ARRIVED
    assert controller.plan(seen()) is Outcome.SEQUENCE_COMPLETED


def test_the_searches_share_what_the_budget_has_left_and_fewer_horizons_are_tried():
    search = Scripted(evaluations=30)
    mpc(spec(evaluations_max=100), 99, search).plan(seen())
    assert [budget for *_, budget in search.asked] == [100 // 3, 70 // 2, 40]


@pytest.mark.parametrize("budget", [6, 7, 20, 33, 60, 1000])
def test_a_step_spends_no_more_than_its_budget(budget):
    controller = mpc(spec(evaluations_max=budget), 99)
    for k in range(4):
        plan = controller.plan(seen(now=k))
        if isinstance(plan, Outcome):
            assert (k > 0, plan) == (True, Outcome.SEQUENCE_COMPLETED)
            return
        assert 5 <= plan.evaluations <= budget
        assert plan.cost == min(search.cost for search in plan.searches)


def spec_around(**fields):
    return spec(accept_error=20, horizon_max=30, steps_max=60, **fields)


def test_where_no_plan_ends_within_accept_longer_ones_are_searched_afresh():
    search = Scripted({6: 0.0})
    controller = mpc(spec_around(), 99, search)
    controller.plan(seen())
    search.forget()
    search.costs = {4: 25.0, 5: 24.0, 6: 21.0, 8: 1.9}
    plan = controller.plan(seen(now=200_000_000))
    asked = [(length, start is None) for length, start, *_ in search.forget()]
    assert asked == [(4, False), (5, False), (6, False), (7, True), (8, True)]
    assert plan.search.length == 8


def test_a_plan_within_accept_is_followed():
    search = Scripted({6: 0.0})
    controller = mpc(spec_around(), 99, search)
    controller.plan(seen())
    search.forget()
    search.costs = {5: 20.0}
    controller.plan(seen(now=200_000_000))
    assert [length for length, *_ in search.asked] == [4, 5, 6]


def test_each_time_the_robots_go_round_a_tenth_more_is_accepted():
    search = Scripted({6: 0.0})
    controller = mpc(spec_around(), 99, search)
    controller.plan(seen())
    search.costs = {8: 1.9}
    controller.plan(seen(now=200_000_000))
    search.forget()
    search.costs = {7: 21.9}
    controller.plan(seen(now=400_000_000))
    assert max(length for length, *_ in search.forget()) == 8
    search.costs = {6: 22.1}
    controller.plan(seen(now=600_000_000))
    assert max(length for length, *_ in search.forget()) > 8


def test_no_plan_is_longer_than_the_steps_that_are_left():
    search = Scripted({6: 0.0})
    controller = mpc(spec(accept_error=20, horizon_max=30, steps_max=9), 99, search)
    controller.plan(seen())
    search.forget()
    search.costs = {}
    controller.plan(seen(now=200_000_000))
    assert [length for length, *_ in search.asked] == [4, 5, 6, 7, 8]


def test_longer_plans_are_searched_on_where_the_deadline_came_between():
    search, time = Scripted({6: 0.0}), 0

    def timer():
        nonlocal time
        time += 10_000_000
        return time

    section = spec_around(deadline=0.075).controller
    controller = section.build(spec_around().setup, 99, lambda _: search, timer)
    controller.plan(seen())
    search.forget()
    search.costs = {}
    controller.plan(seen(now=200_000_000))
    first = [length for length, *_ in search.forget()]
    controller.plan(seen(now=400_000_000))
    second = [length for length, *_ in search.forget()]
    assert first[:4] == [4, 5, 6, 7]
    assert second[3] > first[-1]


def near(total):
    poses = TARGETS.copy()
    poses[0, 0] -= total
    return poses


def test_the_trial_ends_where_stopping_is_as_good_as_the_plan():
    """What is left of the plan, two signals, leads past the targets."""
    search = Scripted({3: 0.0})
    controller = mpc(spec_around(), 99, search)
    controller.plan(seen())
    assert controller.plan(seen(near(15), now=200_000_000)) is Outcome.NOTHING_BETTER


def test_without_a_signal_left_only_an_accepted_error_ends_the_trial():
    search = Scripted({1: 0.0})
    controller = mpc(spec_around(), 99, search)
    controller.plan(seen())
    assert isinstance(controller.plan(seen(near(25), now=200_000_000)), Plan)
    controller.warm = np.zeros(1)
    assert controller.plan(seen(near(19), now=400_000_000)) is Outcome.SEQUENCE_COMPLETED


def beside_a_wall(gap, stop=True, radius=0):
    """A controller with an empty plan, and robots of which green heads for the right wall."""
    collision = {"test": "swept", "walls": True, "radius": radius}
    experiment = spec_around(collision=collision | {"stop_before_collision": stop})
    controller = mpc(experiment, 99)
    poses = STARTS.copy()
    poses[0, 0] = experiment.setup.arena.right - gap
    controller.plan(seen())
    controller.estimator.sent(Command(0.0, 0, (True,) * 3))
    controller.warm = np.empty(0)
    return controller, seen(poses, now=200_000_000)


def decisions_beside_a_wall(count):
    """The decisions from the stop on, with green where it stopped; it drives 36 mm in a period."""
    controller, there = beside_a_wall(30)
    controller.blocked = True
    found, command = [], None
    for k in range(count):
        now = 200_000_000 + k * 700_000_000
        found.append(controller.plan(replace(there, sampled_ns=now, received_ns=now), command, ()))
        facing = getattr(found[-1], "facing", None)
        command = Command(None, now, (True,) * 3, facing=facing)
    return found


def test_robots_stop_and_turn_on_the_spot_rather_than_leave_where_every_plan_does():
    stop, *turns, rest = decisions_beside_a_wall(2 + mpc_module.TURN_STEPS)
    assert all(plan.pauses for plan in (stop, *turns, rest))
    assert stop.facing is None
    assert len(turns[0].searches) > 1  # from standing nothing could move safely
    assert math.cos(turns[0].facing) < 0  # away from the right wall
    assert {plan.facing for plan in turns} == {turns[0].facing}
    assert rest.facing is None  # plans are for robots at rest


def test_a_trial_ends_after_a_pause_where_no_turn_gives_a_way_out(monkeypatch):
    monkeypatch.setattr("tetractl.control.detour.turn_away", lambda *_: None)
    stop, again, end = decisions_beside_a_wall(3)
    assert stop.pauses
    assert again.pauses
    assert len(again.searches) > 1
    assert end is Outcome.NOTHING_BETTER


def test_robots_turn_only_so_often_before_they_drive():
    *plans, end = decisions_beside_a_wall(3 + mpc_module.TURNS // mpc_module.TURN_STEPS * 5)
    assert sum(plan.facing is not None for plan in plans) == mpc_module.TURNS
    assert end is Outcome.NOTHING_BETTER


@pytest.mark.parametrize(
    ("gap", "radius", "blocked", "stop"),
    [(30, 0, False, True), (50, 0, True, True), (90, 47, True, True), (30, 0, True, False)],
)
def test_robots_drive_on_where_a_plan_keeps_clear_or_no_wall_is_reached(gap, radius, blocked, stop):
    controller, there = beside_a_wall(gap, stop, radius)
    controller.blocked = blocked
    plan = controller.plan(there)
    assert isinstance(plan, Plan)
    assert not plan.pauses


@pytest.mark.parametrize(("gap", "radius"), [(30, 0), (-30, 0), (70, 47), (30, 47)])
def test_robots_stop_before_a_body_touches_a_wall_or_goes_deeper(gap, radius):
    controller, there = beside_a_wall(gap, radius=radius)
    controller.blocked = True
    assert controller.plan(there).pauses


@pytest.mark.parametrize(("gap", "blocked"), [(1000, False), (1, True)])  # no turn is tight enough
def test_a_plan_that_touches_an_obstacle_or_its_margin_is_known_as_blocked(gap, blocked):
    controller, there = beside_a_wall(gap, stop=False)
    controller.plan(there)
    assert controller.blocked is blocked


def test_a_first_plan_that_leads_a_body_into_a_wall_is_not_driven():
    """Regression: green, 5 mm of room before it, came to 21 mm from the edge with its centre."""
    collision = {"test": "swept", "walls": True, "radius": 47, "stop_before_collision": True}
    optimizer = {"type": "multistart"}
    experiment = spec(motion="exact", optimizer=optimizer, collision=collision | {"adaptive": True})
    poses = STARTS.copy()
    poses[0] = [experiment.setup.arena.left + 52, 800, math.pi]
    plan = mpc(experiment, 99).plan(seen(poses))
    assert plan.facing is not None


def test_the_stop_comes_between_two_steps_where_that_is_best():
    """All robots drive along +x; blue is 200 mm/s fast and 20 mm short: in 0.1 s it is there."""
    poses = TARGETS.copy()
    poses[:, 0] -= [18, 20, 15]
    fields = {"dead_time": 0.05, "stop_between": True, "motion": "exact"}
    controller = mpc(spec(**fields), 99, Scripted({1: 0.0}))
    controller.plan(seen())
    controller.estimator.sent(Command(0.0, 0, (True,) * 3))
    poses[:, 0] -= 0.05 * np.array([180, 200, 150])  # on the way for the dead time
    ended = controller.plan(seen(poses, now=200_000_000))
    assert isinstance(ended, End)
    assert ended.outcome is Outcome.SEQUENCE_COMPLETED
    assert ended.delay_ns == pytest.approx(100_000_000, abs=3_000_000)


def ends_at_rest(steps_max=20):
    """A controller whose robots, 15 mm from their targets, are to stop 0.1 s from now."""
    experiment = spec(
        accept_error=20,
        stop_between=True,
        motion="exact",
        steps_max=steps_max,
        collision={"test": "swept", "stop_before_collision": True},
    )
    controller = mpc(experiment, 99, Scripted({1: 0.0}))
    controller.plan(seen())
    controller.estimator.sent(Command(0.0, 0, (True,) * 3))
    poses = TARGETS.copy()
    poses[:, 0] -= [18, 20, 15]
    pause = controller.plan(seen(poses, now=200_000_000))
    assert pause.pauses
    assert pause.delay_ns == pytest.approx(100_000_000, abs=3_000_000)
    return controller, Command(None, 300_000_000, (True,) * 3)


def test_a_trial_of_robots_that_can_stand_ends_at_rest():
    controller, stop = ends_at_rest()
    assert controller.plan(seen(near(19), now=1_000_000_000), stop) is Outcome.NOTHING_BETTER


def test_robots_that_rest_off_their_targets_go_on():
    controller, stop = ends_at_rest()
    assert controller.plan(seen(near(21), now=1_000_000_000), stop).direction is not None


def test_robots_that_rest_off_their_targets_without_time_for_a_plan_end_there():
    controller, stop = ends_at_rest(steps_max=6)
    assert controller.plan(seen(near(21), now=1_000_000_000), stop) is Outcome.NOTHING_BETTER


def spread(**fields):
    return spec(
        initial_lengths="geometric", optimizer={"type": "multistart", "tolerance": 1}, **fields
    )


@pytest.mark.parametrize("shortest", [26, 27, 33, 41, 60])
def test_spread_lengths_come_near_the_shortest_that_is_good_enough(shortest):
    """Red has the longest way: 894 mm at 150 mm/s are 30 signals."""
    search = Scripted(dict.fromkeys(range(shortest, 200), 0.5))
    experiment = spread(horizon_max=100)
    plan = mpc(experiment, 99, search).plan(seen())
    asked = [length for length, *_ in search.asked]
    assert asked[0] == 30
    assert max(30, shortest) <= plan.search.length <= max(31, 1.06 * shortest + 1)
    assert len(asked) <= 9


def test_spread_lengths_end_with_the_horizon():
    search = Scripted()
    mpc(spread(horizon_max=40), 99, search).plan(seen())
    asked = [length for length, *_ in search.asked]
    assert asked[:3] == [30, 39, 40]
    assert max(asked) == 40  # also of those that are searched thoroughly then

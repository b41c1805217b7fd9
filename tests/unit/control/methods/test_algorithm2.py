"""Tests of Algorithm 2 as published, line by line."""

from testkit.scripted import TARGETS, Scripted, mpc, observation_of
from testkit.trials import experiment

from tetractl.control.search.rng import mix
from tetractl.core.commands import Command, Steer
from tetractl.core.plan import Outcome, Plan


def spec(**controller):
    fields = {"horizon_max": 6, "optimizer": {"particles": 5, "iterations": 3}}
    return experiment(controller=fields | controller)


def test_step_0_tries_every_horizon_from_nothing_and_takes_the_best():
    search = Scripted({4: 7.0})
    controller = mpc(spec(), 99, search)
    plan = controller.plan(observation_of())
    assert isinstance(plan, Plan)
    assert [(length, warm) for length, warm, *_ in search.asked] == [(n, None) for n in range(1, 7)]
    assert (plan.chosen, plan.search.length, plan.cost) == (3, 4, 7.0)
    assert plan.signals is plan.searches[3].signals
    assert len(plan.searches) == 6
    assert plan.evaluations == 6 * 10  # a scripted search spends 10


def test_later_steps_try_one_less_as_many_and_one_more_from_the_warm_start():
    """Algorithm 2, lines 10-21; u_(warm) is u_(opt) without its first signal."""
    search = Scripted({4: 7.0})
    controller = mpc(spec(), 99, search)
    first = controller.plan(observation_of())
    assert isinstance(first, Plan)
    warm = first.signals[1:].tolist()
    search.forget()
    search.costs = {2: 3.0}
    second = controller.plan(observation_of(now_ns=200_000_000))
    assert isinstance(second, Plan)
    assert [(length, start) for length, start, *_ in search.forget()] == [
        (2, warm[1:]),  # H - 1 = 2: without its first signal
        (3, warm),
        (4, [*warm, 0.0]),
    ]
    # now H = 1: a sequence of no signals cannot be searched
    controller.plan(observation_of(now_ns=400_000_000))
    warm = second.signals[1:].tolist()
    assert [(length, start) for length, start, *_ in search.forget()] == [
        (1, warm),
        (2, [*warm, 0.0]),
    ]


def test_draws_come_from_the_key_the_step_and_the_length():
    search = Scripted({n: 100.0 - n for n in range(20)})
    controller = mpc(spec(), 99, search)
    keys = set()
    for k in range(3):
        plan = controller.plan(observation_of())
        assert isinstance(plan, Plan)
        assert plan.generator == mix(99, k)
        for length, _, key, _ in search.forget():
            assert key == mix(mix(99, k), length)
            keys.add(key)
    assert len(keys) == 6 + 3 + 3  # lengths of the first step and of the two after it


def test_a_used_up_sequence_is_the_outcome():
    search = Scripted({1: 0.0})
    controller = mpc(spec(), 99, search)
    assert isinstance(controller.plan(observation_of()), Plan)
    assert controller.plan(observation_of()) is Outcome.SEQUENCE_COMPLETED


def test_arrival_means_every_robot_within_the_tolerance():
    near = TARGETS.copy()
    near[:, 0] += [20, -20, 0]
    near[2, 1] += 20.001
    controller = mpc(spec(arrival_tolerance=20), 99, Scripted())
    assert isinstance(controller.plan(observation_of(near)), Plan)
    near[2, 1] = 2020
    assert controller.plan(observation_of(near)) is Outcome.ARRIVED


def test_steps_are_counted_however_long_each_takes():
    """Regression: after late steps its time was over before k_max."""
    controller = mpc(spec(steps_max=2), 99, Scripted({6: 0.0}))
    sent = [Command(Steer(0.0), k * 10**9, (True,) * 3) for k in range(3)]
    decisions = [controller.plan(observation_of())]
    for command in sent:
        a_second_later = observation_of(now_ns=command.sent_ns + 10**9)
        decisions.append(controller.plan(a_second_later, command))
    assert all(isinstance(command, Plan) for command in decisions[:3])
    assert decisions[3] is Outcome.STEPS_MAX

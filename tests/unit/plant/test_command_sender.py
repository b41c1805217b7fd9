"""Tests of when a simulated host sends commands, when they act, and which robots receive them."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.trials import experiment

from tetractl.core.clock import NEVER_NS, SECOND
from tetractl.core.commands import FieldOff, Steer, Stop, Turn
from tetractl.core.poses import Observation, Poses
from tetractl.plant.command_sender import STOPS_MAX, CommandSender
from tetractl.spec.disturbance import Disturbance
from tetractl.spec.lab_section import STOP_COUNT, STOP_GAP_NS

SETUP = replace(experiment().setup, wheel_radius=None)
ROBOTS = len(SETUP.names)
TIMES_NS = st.integers(0, 10 * SECOND)


class Transit:
    """Takes commands; `loses` says which robots the command of a number does not reach."""

    def __init__(self, loses=lambda number: ()):
        self.sent = []
        self.loses = loses

    def send(self, command, now_ns):
        lost = self.loses(len(self.sent))
        self.sent.append(command)
        reached = command.reached & ~np.isin(np.arange(ROBOTS), lost)
        return replace(command, reached=reached)


class LosesCommands(Disturbance):
    """Stands for any disturbance that acts on what is sent."""

    def sent(self, command, now_ns):
        return command


def sender(transit, setup=SETUP, disturbances=(), seed=1, **settings):
    values = SimpleNamespace(**{"lost_commands": 0.0, "dead_time": 0.1} | settings)
    random = np.random.default_rng(seed)
    return CommandSender(values, setup, None, transit, disturbances, random)


def frame(sampled_ns=0, headings=(0.0, 0.5, -2.0)):
    poses = Poses.from_array(np.column_stack([np.zeros((ROBOTS, 2)), np.array(headings)]))
    return Observation(1, sampled_ns, sampled_ns, poses, np.ones(ROBOTS, dtype=bool))


@given(TIMES_NS, TIMES_NS, st.floats(0, 2))
def test_a_command_acts_a_dead_time_after_the_frame_but_never_before_it_is_sent(
    sampled_ns, planning_ns, dead_time
):
    transit = Transit()
    now_ns = sampled_ns + planning_ns
    sent = sender(transit, dead_time=dead_time).send(now_ns, frame(sampled_ns), Steer(0.3))
    (command,) = transit.sent
    assert sent.sent_ns == command.sent_ns == now_ns
    if planning_ns >= dead_time * SECOND:
        assert command.due_ns == now_ns
    else:
        assert command.due_ns == pytest.approx(sampled_ns + dead_time * SECOND, abs=1)


@pytest.mark.parametrize(("lost", "low", "high"), [(0.0, 1, 1), (1.0, 0, 0), (0.3, 0.65, 0.75)])
def test_as_many_commands_are_lost_as_the_spec_says(lost, low, high):
    host = sender(Transit(), lost_commands=lost)
    delivered = [host.send(0, frame(), Steer(0.0)).delivered for _ in range(500)]
    assert low <= np.mean(delivered) <= high


def test_an_action_is_held_until_the_next_one():
    transit = Transit()
    host = sender(transit)
    actions = [host.send(0, frame(), action).action for action in (None, Steer(0.3), None, Turn(1))]
    assert actions == [FieldOff(), Steer(0.3), Steer(0.3), Turn(1)]
    assert [command.action for command in transit.sent] == actions
    assert host.next_repeat_ns == NEVER_NS


def test_one_stop_is_enough_where_none_can_be_lost():
    transit = Transit()
    sent = sender(transit, lost_commands=0.9).send_stops(5, frame())
    assert len(transit.sent) == 1
    assert (sent.action, sent.sent_ns, sent.delivered) == (Stop(), 5, (True,) * ROBOTS)
    assert transit.sent[0].reached.all()


def test_stops_are_repeated_until_every_robot_has_one():
    last = 17
    transit = Transit(lambda number: [1] if number < last else [0, 2])
    sent = sender(transit, disturbances=[LosesCommands()]).send_stops(5, frame())
    assert len(transit.sent) == last + 1
    assert sent.delivered == (True,) * ROBOTS
    times_ns = [command.sent_ns for command in transit.sent]
    assert times_ns == [5 + k * STOP_GAP_NS for k in range(last + 1)]
    assert all(command.due_ns >= command.sent_ns for command in transit.sent)
    assert not any(command.wheels.any() for command in transit.sent)


def test_stops_that_all_arrive_are_ten_and_those_that_never_do_end():
    transit = Transit()
    disturbances = [LosesCommands()]
    assert all(sender(transit, disturbances=disturbances).send_stops(0, frame()).delivered)
    assert len(transit.sent) == STOP_COUNT
    deaf = Transit(lambda _: [2])
    sent = sender(deaf, disturbances=disturbances).send_stops(0, frame())
    assert sent.delivered == (True, True, False)
    assert len(deaf.sent) == STOPS_MAX


def test_wheel_speeds_are_those_of_24_and_25_and_only_of_robots_with_wheels():
    assert sender(Transit()).send(0, frame(), Steer(1.0)).left is None
    assert sender(Transit()).send_stops(0, frame()).left is None
    wheeled = replace(SETUP, wheel_radius=40.0)
    observed = frame()
    for action, speed in ((Steer(1.0), SETUP.speed), (Turn(1.0), 0 * SETUP.speed)):
        sent = sender(Transit(), wheeled).send(0, observed, action)
        for i, heading in enumerate(observed.poses.heading):
            difference = SETUP.a[i] * 40.0 * math.sin(1.0 - heading)
            assert sent.left[i] == pytest.approx(speed[i] - difference)
            assert sent.right[i] == pytest.approx(speed[i] + difference)
    off = sender(Transit(), wheeled).send(0, observed, FieldOff())
    assert off.left == pytest.approx(SETUP.speed)
    stopped = sender(Transit(), wheeled).send_stops(0, observed)
    assert not stopped.left.any()
    assert not stopped.right.any()

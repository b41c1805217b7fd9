"""Tests of commands on their way to simulated robots, and of the robots' watchdogs."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.clock import NEVER_NS, SECOND
from tetractl.core.commands import Steer, Stop
from tetractl.plant.transit import Transit, Watchdogs
from tetractl.spec.disturbance import DelayedCommand, Disturbance

TIMES_NS = st.integers(0, 1000)
LATE_NS = st.none() | st.lists(st.integers(0, 300), min_size=3, max_size=3)
SENDINGS = st.lists(st.tuples(TIMES_NS, st.integers(0, 300), LATE_NS), min_size=1, max_size=12)


def command(sent_ns, due_ns, reached=(True, True, True), late_ns=None, action=None):
    late = None if late_ns is None else np.array(late_ns)
    return DelayedCommand(sent_ns, due_ns, action or Steer(sent_ns / 1e4), np.array(reached), late)


def arrivals(transit):
    """Take all commands; return the times of sending and arrival of what each robot receives."""
    received = [[], [], []]
    while transit.next_due_ns != NEVER_NS:
        due_ns = transit.next_due_ns
        part = transit.pop()
        assert part.due_ns == due_ns
        for i in np.flatnonzero(part.reached):
            received[i].append((part.sent_ns, part.due_ns))
    return received


@given(SENDINGS)
def test_each_robot_receives_every_command_once_in_order_as_early_as_the_previous_one_allows(rows):
    transit = Transit(3, [])
    expected = [[], [], []]
    last_ns = [0, 0, 0]
    last_due_ns = 0
    for now_ns, delay_ns, late_ns in sorted(rows, key=lambda row: row[0]):
        transit.send(command(now_ns, now_ns + delay_ns, late_ns=late_ns), now_ns)
        for i, late in enumerate(late_ns or [0, 0, 0]):
            last_ns[i] = max(last_ns[i], now_ns + delay_ns + late)
            expected[i].append((now_ns, last_ns[i]))
        last_due_ns = max(last_ns)
        assert transit.last_due_ns == last_due_ns
    assert arrivals(transit) == expected


def test_a_command_that_is_due_in_the_past_acts_when_it_is_sent():
    transit = Transit(3, [])
    transit.send(command(0, 40), now_ns=100)
    assert transit.next_due_ns == transit.last_due_ns == 100
    assert arrivals(transit) == [[(0, 100)]] * 3


@pytest.mark.parametrize("late_ns", [None, [0, 50, 0]])
def test_a_robot_that_loses_a_command_receives_no_part_of_it(late_ns):
    transit = Transit(3, [])
    transit.send(command(5, 20, (True, False, True), late_ns), now_ns=5)
    assert arrivals(transit) == [[(5, 20)], [], [(5, 20)]]


def test_robots_with_the_same_delay_receive_one_command_together():
    transit = Transit(3, [])
    transit.send(command(0, 10, late_ns=[7, 0, 7]), now_ns=0)
    parts = [transit.pop(), transit.pop()]
    assert [part.due_ns for part in parts] == [10, 17]
    assert [part.reached.tolist() for part in parts] == [[False, True, False], [True, False, True]]
    assert transit.next_due_ns == NEVER_NS


def test_without_a_command_nothing_is_on_its_way():
    transit = Transit(2, [])
    assert (transit.next_due_ns, transit.last_due_ns) == (NEVER_NS, 0)


def test_disturbances_change_a_command_one_after_another_and_the_sender_gets_the_result():
    class Later(Disturbance):
        def sent(self, command):
            return DelayedCommand(0, 2 * command.due_ns + 1, command.action, command.reached)

    transit = Transit(3, [Later(), Disturbance(), Later()])
    sent = transit.send(command(0, 10), now_ns=0)
    assert sent.due_ns == transit.next_due_ns == 43


def test_a_watchdog_expires_after_its_timeout_for_those_that_received_the_command():
    watchdogs = Watchdogs(3, 0.25)
    assert watchdogs.next_expiry_ns == NEVER_NS
    watchdogs.restart(command(0, SECOND, (True, False, True)))
    assert watchdogs.next_expiry_ns == 1.25 * SECOND
    watchdogs.restart(command(0, 2 * SECOND, (True, True, False)))
    assert watchdogs.next_expiry_ns == 1.25 * SECOND, (
        "the third robot has not received the second one"
    )
    stop = watchdogs.stop_expired(watchdogs.next_expiry_ns)
    assert stop.reached.tolist() == [False, False, True]
    assert stop.sent_ns == stop.due_ns == 1.25 * SECOND
    assert isinstance(stop.action, Stop)
    assert stop.wheels.tolist() == [[0, 0, 0], [0, 0, 0]]
    watchdogs.restart(stop)
    assert watchdogs.next_expiry_ns == 2.25 * SECOND
    assert watchdogs.stop_expired(watchdogs.next_expiry_ns).reached.tolist() == [True, True, False]


def test_a_stopped_robot_has_no_watchdog_until_its_next_command():
    watchdogs = Watchdogs(1, 0.5)
    watchdogs.restart(command(0, 0, (True,)))
    watchdogs.restart(command(1, 100, (True,), action=Stop()))
    assert watchdogs.next_expiry_ns == NEVER_NS
    watchdogs.restart(command(1, 200, (True,)))
    assert watchdogs.next_expiry_ns == SECOND // 2 + 200


def test_robots_without_watchdogs_never_stop_by_themselves():
    watchdogs = Watchdogs(2, math.inf)
    watchdogs.restart(command(0, 5, (True, True)))
    assert watchdogs.next_expiry_ns == NEVER_NS

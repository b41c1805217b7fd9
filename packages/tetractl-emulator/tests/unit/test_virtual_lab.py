"""The clock that an emulated lab and the program share: whose time it is, and what acts when."""

import pytest
from testkit.emulator.acting import act
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.loop import Timeline
from tetractl_emulator.virtual_lab import LabClock

from tetractl.core.clock import MILLISECOND, SECOND


@pytest.fixture
def clock():
    clock = LabClock()
    clock.set_emulation(Timeline(lambda when_ns: None), acting=ActingFaults())
    return clock


@pytest.mark.parametrize("by_s", [3600.0, 0.25, 0.001, -0.5])
def test_a_clock_that_is_set_differs_by_the_seconds_that_are_stated(clock, by_s):
    clock.sleep_until(SECOND)
    fault = act(clock.acting, "host_clock", by=by_s)
    assert clock.now() - clock.true_ns == round(by_s * SECOND)
    assert clock.true_ns == SECOND
    act(clock.acting, "host_clock", by=2.0)
    assert clock.now() - clock.true_ns == round((by_s + 2.0) * SECOND)
    clock.acting.remove(fault)
    assert clock.now() - clock.true_ns == 2 * SECOND


def test_a_sleep_is_as_long_as_it_seems_to_the_host(clock):
    act(clock.acting, "host_clock", by=5.0)
    clock.sleep_until(5 * SECOND + 40 * MILLISECOND)
    assert clock.true_ns == 40 * MILLISECOND
    clock.sleep_until(SECOND)  # has passed already
    assert clock.true_ns == 40 * MILLISECOND


def test_each_millisecond_all_act_in_their_order_and_watchers_last(clock):
    calls = []
    clock.watchers.append(lambda: calls.append(("watcher", clock.true_ns)))
    clock.steps.append(lambda: calls.append(("step", clock.true_ns)))
    clock.receivers.append(lambda: calls.append(("receiver", clock.true_ns)))
    clock.sleep_until(2 * MILLISECOND + 5)
    times = [MILLISECOND, 2 * MILLISECOND, 2 * MILLISECOND + 5]
    assert calls == [(who, at) for at in times for who in ("receiver", "step", "watcher")]


def test_while_the_process_is_suspended_only_the_emulation_goes_on(clock):
    timeline = Timeline(lambda when_ns: None)
    acting = ActingFaults()
    clock.set_emulation(timeline, acting=acting)
    calls = []
    fault = act(acting, "stopped")
    timeline.at(3 * MILLISECOND, lambda: acting.remove(fault))
    clock.steps.append(lambda: calls.append(clock.true_ns))
    clock.sleep_until(MILLISECOND)
    assert clock.true_ns == 3 * MILLISECOND
    clock.sleep_until(4 * MILLISECOND)
    assert calls == [3 * MILLISECOND, 4 * MILLISECOND]

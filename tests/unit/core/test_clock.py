import sys
import time

import pytest

from tetractl.core import clock as clock_module
from tetractl.core.clock import SECOND, MonotonicClock, VirtualClock, wait_for


def test_virtual_time_passes_only_by_sleeping():
    clock = VirtualClock()
    assert clock.now() == 0
    clock.sleep_until(5)
    clock.sleep_until(3)  # past: it never goes back
    assert clock.now() == 5


class SleepyHost:
    """Stands for the host's clock. It goes on only while the host sleeps, and the host is woken
    from its first sleep after half of it."""

    def __init__(self):
        self.now_ns = 10**15
        self.sleeps_s = []

    def sleep(self, seconds):
        is_woken_early = not self.sleeps_s
        self.sleeps_s.append(seconds)
        slept_s = seconds / 2 if is_woken_early else seconds
        self.now_ns += round(slept_s * SECOND)


@pytest.fixture
def host(monkeypatch):
    host = SleepyHost()
    monkeypatch.setattr(clock_module, "host_ns", lambda: host.now_ns)
    monkeypatch.setattr(time, "sleep", host.sleep)
    return host


def test_monotonic_time_starts_at_0_and_sleeps_to_the_end(host):
    clock = MonotonicClock()
    assert clock.now() == 0
    clock.sleep_until(8_000_000)
    assert clock.now() == 8_000_000
    assert host.sleeps_s == [0.008, 0.004]  # woken early, it sleeps on


@pytest.mark.skipif(sys.platform != "linux", reason="the name of Linux's clock")
def test_the_hosts_clock_goes_on_while_the_computer_sleeps(monkeypatch):
    """The kernel's CLOCK_MONOTONIC stands meanwhile, and pictures that waited seemed new."""
    clock = MonotonicClock()
    asleep_ns = 5 * SECOND
    true_time_ns = time.clock_gettime_ns

    def time_after_a_sleep_ns(which):
        goes_on = which == time.CLOCK_BOOTTIME
        return true_time_ns(which) + (asleep_ns if goes_on else 0)

    monkeypatch.setattr(time, "clock_gettime_ns", time_after_a_sleep_ns)
    assert clock.now() >= asleep_ns


def test_monotonic_time_does_not_sleep_until_what_is_past(host):
    clock = MonotonicClock()
    clock.sleep_until(8_000_000)
    host.sleeps_s.clear()
    clock.sleep_until(8_000_000)
    clock.sleep_until(1)
    assert host.sleeps_s == []


def test_new_values_that_come_fast_do_not_put_off_the_next_repetition():
    """Each is sent at once: at 50 a second with a repetition every 25 ms, the next one was due 5 ms
    later with each, after a minute 15 s."""
    period_ns = 25
    due_ns = 0
    for sent_ns in range(0, 60_000, 20):
        due_ns = clock_module.next_due_ns(due_ns, sent_ns, period_ns)
        assert due_ns <= sent_ns + 2 * period_ns


def test_what_is_sent_late_keeps_its_rate_but_for_half_a_period():
    assert clock_module.next_due_ns(due_ns=100, sent_ns=104, period_ns=20) == 120
    assert clock_module.next_due_ns(due_ns=100, sent_ns=150, period_ns=20) == 160


@pytest.mark.parametrize("at_s", [0.0, 0.0105, 0.4])
def test_what_is_waited_for_is_noticed_within_two_milliseconds(at_s):
    clock = VirtualClock()
    assert wait_for(clock, lambda: clock.now() >= at_s * SECOND, 0.5)
    assert at_s <= clock.now() / SECOND <= at_s + 0.0021


@pytest.mark.parametrize("timeout_s", [0.0, 0.001, 0.0035, 0.5])
def test_what_does_not_happen_is_waited_for_until_the_timeout_exactly(timeout_s):
    clock = VirtualClock()
    clock.sleep_until(7 * SECOND)
    assert not wait_for(clock, lambda: False, timeout_s)
    assert clock.now() == 7 * SECOND + round(timeout_s * SECOND)

import sys
import time

import pytest

from tetractl.core import clock as clock_module
from tetractl.core.clock import SECOND, MonotonicClock, VirtualClock


def test_virtual_time_passes_only_by_sleeping():
    clock = VirtualClock()
    assert clock.now() == 0
    clock.sleep_until(5)
    clock.sleep_until(3)  # past: it never goes back
    assert clock.now() == 5


@pytest.fixture
def host(monkeypatch):
    """The host's clock, which moves only by what is slept, and half of it at first."""

    class Host:
        now, slept = 10**15, []

        def sleep(self, seconds):
            self.slept.append(seconds)
            self.now += round(seconds * 1e9 / (2 if len(self.slept) == 1 else 1))

    host = Host()
    monkeypatch.setattr(clock_module, "host_ns", lambda: host.now)
    monkeypatch.setattr(time, "sleep", host.sleep)
    return host


def test_monotonic_time_starts_at_0_and_sleeps_to_the_end(host):
    clock = MonotonicClock()
    assert clock.now() == 0
    clock.sleep_until(8_000_000)
    assert clock.now() == 8_000_000
    assert host.slept == [0.008, 0.004]  # woken early, it sleeps on
    clock.sleep_until(8_000_000)
    clock.sleep_until(1)
    assert len(host.slept) == 2


@pytest.mark.skipif(sys.platform != "linux", reason="the name of Linux's clock")
def test_the_hosts_clock_goes_on_while_the_computer_sleeps(monkeypatch):
    """The kernel's CLOCK_MONOTONIC stands meanwhile, and pictures that waited seemed new."""
    clock = MonotonicClock()
    slept = 5 * SECOND
    true = time.clock_gettime_ns
    boot = time.CLOCK_BOOTTIME
    monkeypatch.setattr(time, "clock_gettime_ns", lambda c: true(c) + slept * (c == boot))
    assert clock.now() >= slept

"""Tests of another program's commands that reach emulated robots."""

from types import SimpleNamespace

import pytest
from tetractl_emulator.loop import Timeline
from tetractl_emulator.m3pi.wheeled_side import WheeledSide

from tetractl.core.clock import SECOND
from tetractl.spec.lab_section import STOP_GAP_NS, STOPS


class Radio:
    """Notes what it receives from another sender, with its time."""

    def __init__(self, timeline):
        self.timeline = timeline
        self.sequence = 250
        self.driven = []
        self.stopped = []

    def drive_elsewhere(self, sequence, counts):
        self.driven.append((self.timeline.now_ns, sequence, counts))

    def stop_elsewhere(self, number):
        self.stopped.append((self.timeline.now_ns, number))


class Side(WheeledSide):
    """A side that consists of two radios."""

    def __init__(self):
        self.timeline = Timeline(lambda now_ns: None)
        self._radios = [Radio(self.timeline) for _ in range(2)]

    radios = property(lambda self: self._radios)


def test_another_sender_sends_ten_stops_at_the_usual_times():
    side = Side()
    side.stop_elsewhere()
    side.timeline.run_to(3 * SECOND)
    for radio in side.radios:
        assert radio.stopped == [(k * STOP_GAP_NS, k) for k in range(STOPS)]


@pytest.mark.parametrize("follows", [False, True])
def test_another_sender_drives_at_its_rate_until_the_fault_ends(follows):
    side = Side()
    fault = SimpleNamespace(rate=10.0, follows=follows, counts=(20, -20))
    end = side.drive_elsewhere(fault)
    side.timeline.run_to(SECOND)
    end()
    side.timeline.run_to(2 * SECOND)
    for radio in side.radios:
        assert [at_ns for at_ns, _, _ in radio.driven] == [k * SECOND // 10 for k in range(11)]
        numbers = [sequence for _, sequence, _ in radio.driven]
        assert numbers == ([251] * 11 if follows else list(range(11)))
        assert {counts for _, _, counts in radio.driven} == {(20, -20)}

"""Tests of the serial line between a program and an emulated device."""

from types import SimpleNamespace

import pytest
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.loop import Timeline
from tetractl_emulator.port import SerialDevice

from tetractl.core.clock import SECOND

SENT = b"0.1800 0.0000\n"


class Heard(SerialDevice):
    """A device that keeps what it hears."""

    def __init__(self, timeline, port, acting):
        super().__init__(timeline, port, 57600, None, acting)
        self.chunks = []

    def receive(self, data):
        self.chunks.append(data)

    def _decode_command(self, frame):
        raise NotImplementedError


@pytest.mark.parametrize("name", ["/dev/ttyUSB0", "udp://127.0.0.1:9801"])
def test_a_network_drops_a_datagram_that_was_changed(name):
    """Regression: a robot that trusts UDP's checksum was sent a speed in place of a stop."""
    waiting = [SENT] * 200
    port = SimpleNamespace(
        name=name, baud=lambda: None, read=lambda: waiting.pop() if waiting else b""
    )
    acting = ActingFaults()
    acting.add(SimpleNamespace(fault="bad_bytes", robot=None, share=0.02))
    timeline = Timeline(lambda when_ns: None)
    device = Heard(timeline, port, acting)
    device.read_port()
    timeline.run_to(10 * SECOND)
    changed = [chunk for chunk in device.chunks if chunk != SENT]
    if name.startswith("udp"):
        assert not changed
        assert 100 < len(device.chunks) < 190
    else:
        assert len(device.chunks) == 200
        assert 10 < len(changed) < 100

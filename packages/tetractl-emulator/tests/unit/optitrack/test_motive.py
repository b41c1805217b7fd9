"""Tests of the emulated Motive: its clients, the times of its frames, and garbage."""

from contextlib import suppress

import numpy as np
import pytest
from testkit.emulator.virtual_lab import virtual_lab
from testkit.lab_specs import SPEC
from tetractl_emulator.loop import Loop, Timeline
from tetractl_emulator.optitrack.scripted import OptitrackSettings
from tetractl_emulator.optitrack.side import EmulatedOptitrack
from tetractl_emulator.sides import Options, Stage

from tetractl.core.clock import SECOND
from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.wire import pack_message, parse_datagram
from tetractl.spec.load import parse_spec

TICKS_PER_MS = 10_000  # of the server's clock


class Client:
    """A bare NatNet client on one socket."""

    def __init__(self, lab):
        self.motive = lab.emulation.camera
        self.clock = lab.clock
        self.socket = lab.emulation.wires.bound("127.0.0.1", 0)

    def send(self, data):
        data = data if isinstance(data, bytes) else pack_message(data)
        self.socket.sendto(data, (self.motive.ports.address, self.motive.ports.command_port))

    def got(self):
        """Return the messages that came since the last call."""
        gathered = []
        with suppress(BlockingIOError):
            while True:
                gathered.append(
                    parse_datagram(self.socket.recvfrom(65_535)[0], self.motive.own_version)
                )
        return gathered

    def comes(self, kind):
        """Let time pass until a message of a kind comes; return whether it does."""

        def has_come():
            return any(isinstance(message, kind) for message in self.got())

        return self.clock.wait(has_come)


@pytest.fixture
def client(tmp_path):
    with virtual_lab(tmp_path) as lab:
        yield Client(lab)


@pytest.mark.long
def test_unicast_clients_time_out_and_are_kept_alive(client):
    motive = client.motive
    clock = client.clock
    for _ in range(2):
        client.send(natnet.Connect())
        assert client.comes(natnet.ServerInfo)
        clock.sleep_until(clock.now() + 4 * SECOND)
        client.send(natnet.BareMessage(natnet.MessageKind.KEEPALIVE))
        clock.sleep_until(clock.now() + 4 * SECOND)
        client.got()
        assert client.comes(natnet.NatNetFrame)
        assert clock.wait(lambda: not motive.clients)
        # too late: it has to connect again
        client.send(natnet.BareMessage(natnet.MessageKind.KEEPALIVE))
        client.send(natnet.NatNetRequest("UpAxis"))
        assert client.comes(natnet.Response)
        assert not motive.clients
    assert motive.counts["timed_out"] == 2


def test_latency_and_jitter_are_those_of_the_real_capture():
    """A minute of frames at 120 Hz in virtual time, the same every time."""
    timeline = Timeline(lambda when: None)
    spec = parse_spec(SPEC, "spec.yaml").experiment
    nothing = [lambda *_, **__: None] * 4
    stage = Stage(spec.lab, spec.setup, timeline, Options(command_port=0, data_port=0), *nothing)
    motive = EmulatedOptitrack(stage, OptitrackSettings(), [])
    exposures = []
    sent_ns = []

    def keep(frame, now):
        exposures.append(frame.exposure)
        sent_ns.append(now)

    motive._stream = keep
    motive.open(Loop(timeline, lambda lag: None))
    try:
        timeline.run_to(60 * SECOND)
    finally:
        motive.close()
    sent_ticks = [motive.ticks(now) for now in sent_ns]
    delays_ms = (np.array(sent_ticks) - exposures) / TICKS_PER_MS
    gaps_ms = np.diff(sent_ns) / 1e6
    assert len(sent_ns) == pytest.approx(60 * 120, abs=2)
    assert delays_ms.mean() == pytest.approx(5.4, abs=0.1)
    assert gaps_ms.mean() == pytest.approx(1000 / 120, abs=0.01)
    assert 0.3 < gaps_ms.std(ddof=1) < 0.6
    assert gaps_ms.min() > 3.8
    assert gaps_ms.max() < 12.8

"""The emulated Motive over real UDP, against our client's codec and against PyPI's `natnet`."""

import socket
import statistics
from itertools import pairwise

import pytest
from support.lab_processes import emulated, turn_until
from support.lab_specs import SPEC

from tetractl.emulate.loop import Timeline
from tetractl.emulate.optitrack.motive import Motive, OptitrackSettings, ServerClock
from tetractl.emulate.sides import Options, Stage
from tetractl.experiment.load import parse_spec
from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.pose import UpAxis, planar_pose
from tetractl.lab.cameras.optitrack.wire import pack, parse


class Client:
    """A bare NatNet client on one socket."""

    def __init__(self, lab):
        self.lab = lab
        self.version = lab.camera.motive.own_version
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.socket.bind(("127.0.0.1", 0))
        self.got = []

    def send(self, message):
        self.socket.sendto(pack(message), ("127.0.0.1", self.lab.camera.motive.command_port))

    def poll(self):
        try:
            while True:
                self.got.append(parse(self.socket.recv(65535), self.version))
        except BlockingIOError:
            return self.got

    def ask(self, message, kind):
        """Send and return the first answer of a kind; forget all others that came."""
        self.got.clear()
        self.send(message)
        return self.next(kind)

    def next(self, kind, count=1):
        found = turn_until(
            self.lab,
            lambda: (
                (of := [m for m in self.poll() if isinstance(m, kind)]) and len(of) >= count and of
            ),
        )
        return found[0] if count == 1 else found[:count]


@pytest.fixture
def opened(tmp_path):
    open_now = []

    def start(*sets, **options):
        lab = emulated(tmp_path, *sets, **options)
        lab.__enter__()
        client = Client(lab)
        open_now.extend((lab, client.socket))
        return lab, client

    yield start
    for thing in reversed(open_now):
        thing.close()


@pytest.mark.parametrize("version", ["2.6", "2.9", "3.0", "3.1", "4.0", "4.1", "4.2", "4.3"])
def test_handshake_models_and_frames(opened, version):
    lab, client = opened(script=f"emulation: {{camera: {{version: '{version}'}}}}")
    info = client.ask(natnet.Connect(), natnet.ServerInfo)
    assert str(info.version) == version
    assert "EMULATED" in info.name
    assert info.data_port == (lab.camera.motive.data_port if info.version >= (3, 0) else 0)
    models = client.ask(natnet.Bare(natnet.MessageKind.REQUEST_MODELDEF), natnet.ModelDef)
    assert models.ids() == {"Green": 1, "blue": 7}
    first, second = client.next(natnet.NatNetFrame, 2)
    assert second.number == first.number + 1
    assert [body.id for body in first.bodies] == [1, 7]
    assert first.params == 0
    poses = [planar_pose(body, UpAxis.Y) for body in first.bodies]
    assert poses[0].x == pytest.approx(0.5)
    assert poses[0].y == pytest.approx(0.5)
    assert poses[0].heading == pytest.approx(0.5, abs=1e-5)
    assert poses[1].heading == pytest.approx(-2.0, abs=1e-5)


def test_unicast_clients_time_out_and_are_kept_alive(opened):
    lab, client = opened()
    client.ask(natnet.Connect(), natnet.ServerInfo)
    (known,) = lab.camera.motive.clients.values()
    known.heard_ns -= 2_000_000_000
    before = known.heard_ns
    client.send(natnet.Bare(natnet.MessageKind.KEEPALIVE))
    turn_until(lab, lambda: known.heard_ns != before)
    client.next(natnet.NatNetFrame)
    known.heard_ns -= 6_000_000_000
    turn_until(lab, lambda: not lab.camera.motive.clients)
    assert lab.camera.motive.timed_out == 1
    client.send(natnet.Bare(natnet.MessageKind.KEEPALIVE))  # too late: it has to connect again
    client.ask(natnet.NatNetRequest("UpAxis"), natnet.Response)
    assert not lab.camera.motive.clients
    client.ask(natnet.Connect(), natnet.ServerInfo)
    client.next(natnet.NatNetFrame)


def test_latency_and_jitter_are_those_of_the_real_capture():
    timeline = Timeline(lambda when: None)  # virtual time: the same minute every time
    spec = parse_spec(SPEC, "spec.yaml").experiment
    nothing = [lambda *_, **__: None] * 4
    stage = Stage(spec.lab, spec.setup, timeline, Options(command_port=0, data_port=0), *nothing)
    motive = Motive(stage, spec.lab.camera, OptitrackSettings(), UpAxis.Y, [], tuple)
    sent = []
    motive._stream = lambda frame, now: sent.append((frame, now))
    motive.open()
    try:
        timeline.run_to(60_000_000_000)
    finally:
        motive.close()
    delays = [(ServerClock().ticks(now) - frame.exposure) / 10_000 for frame, now in sent]  # ms
    gaps = [(b - a) / 1e6 for (_, a), (_, b) in pairwise(sent)]
    assert len(sent) == pytest.approx(7200, abs=2)
    assert statistics.mean(delays) == pytest.approx(5.4, abs=0.1)
    assert statistics.mean(gaps) == pytest.approx(1000 / 120, abs=0.01)
    assert 0.3 < statistics.stdev(gaps) < 0.6
    assert min(gaps) > 3.8
    assert max(gaps) < 12.8


def test_garbage_is_counted_and_survived(opened):
    lab, client = opened()
    for noise in (b"", b"\0", b"\xff" * 300, pack(natnet.Connect())[:-1]):
        client.socket.sendto(noise, ("127.0.0.1", lab.camera.motive.command_port))
    turn_until(lab, lambda: lab.camera.motive.refused == 4)
    assert client.ask(natnet.Connect(), natnet.ServerInfo)

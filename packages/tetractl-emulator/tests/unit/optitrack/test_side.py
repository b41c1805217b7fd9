"""Tests of the emulated Motive, datagram by datagram, in memory and in virtual time."""

import struct
from contextlib import suppress
from types import SimpleNamespace

import pytest
from testkit.emulator.acting import act
from testkit.lab_specs import SPEC
from tetractl_emulator.loop import Timeline
from tetractl_emulator.memory_wires import MemoryNetwork
from tetractl_emulator.optitrack.scripted import OptitrackSettings
from tetractl_emulator.optitrack.side import EmulatedOptitrack
from tetractl_emulator.sides import Options, Stage
from tetractl_emulator.virtual_lab import LabClock, create_memory_wires

from tetractl.core.clock import SECOND
from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.wire import pack_message, parse_datagram
from tetractl.spec.load import parse_spec

OWN = ("127.0.0.1", 41_000)
KIND = natnet.MessageKind


class Motive:
    """An emulated server above green and blue, and the sockets of its clients."""

    def __init__(self, *sets, spec=SPEC, **settings):
        experiment = parse_spec(spec, "spec.yaml", sets).experiment
        lab = experiment.lab
        self.network = MemoryNetwork()
        self.timeline = Timeline(lambda when_ns: None)
        self.greeted = []
        stage = Stage(
            lab,
            experiment.setup,
            self.timeline,
            Options(command_port=1600, data_port=1601),
            None,
            lambda exposure, frame: None,
            lambda exposure: None,
            self.greeted.append,
            create_memory_wires(self.network, LabClock()),
        )
        bodies = [
            SimpleNamespace(name=name, x=100.0, y=200.0, heading=0.0)
            for name in experiment.setup.names
        ]
        self.side = EmulatedOptitrack(stage, OptitrackSettings(**settings), bodies)
        self.read = lambda: None
        loop = SimpleNamespace(watch=self._watch, catch_up=lambda: None)
        self.facts = self.side.open(loop)

    def _watch(self, fd, read):
        self.read = read

    def client(self, host="127.0.0.1"):
        return self.network.bound_socket(host, 0)

    def ask(self, client, message):
        """Send a message to the server; return what it answers, without frames."""
        data = message if isinstance(message, bytes) else pack_message(message)
        client.sendto(data, ("127.0.0.1", self.side.ports.command_port))
        self.read()
        return self.heard(client, False)

    def heard(self, client, frames=True):
        """What has come at a client, frames or all else."""
        heard = []
        with suppress(BlockingIOError):
            while True:
                data, _ = client.recvfrom(65_535)
                is_frame = data[:2] == struct.pack("<H", KIND.FRAME)
                if is_frame == frames:
                    heard.append(parse_datagram(data, self.side.own_version))
        return heard

    def run(self, seconds):
        self.timeline.run_to(self.timeline.now_ns + round(seconds * SECOND))


def test_ports_are_those_of_the_options_and_are_told():
    motive = Motive()
    facts = {key: motive.facts[key] for key in ("address", "command_port", "data_port")}
    assert facts == {"address": "127.0.0.1", "command_port": 1600, "data_port": 1601}
    assert motive.facts["camera"] == "127.0.0.1:1600 (unicast)"


def test_a_client_gets_frames_once_it_has_connected_and_none_after_it_has_left():
    motive = Motive()
    client, other = motive.client(), motive.client()
    motive.run(0.1)
    assert motive.heard(client) == []
    (info,) = motive.ask(client, natnet.Connect())
    assert (info.version, info.data_port) == (motive.side.own_version, 1601)
    motive.run(0.5)
    assert len(motive.heard(client)) == pytest.approx(60, abs=2)
    assert motive.heard(other) == []
    motive.ask(client, natnet.BareMessage(KIND.DISCONNECT))
    motive.ask(client, natnet.BareMessage(KIND.DISCONNECT))
    motive.run(0.1)
    assert motive.heard(client) == []
    assert motive.side.close()["frames"] == pytest.approx(0.7 * 120, abs=2)


def test_a_silent_client_is_dropped_after_five_seconds_and_counted():
    motive = Motive(rate=20.0)
    client, alive = motive.client(), motive.client()
    for each in (client, alive):
        motive.ask(each, natnet.Connect())
    motive.run(4.9)
    assert len(motive.side.clients) == 2
    motive.ask(alive, natnet.BareMessage(KIND.KEEPALIVE))
    motive.run(0.3)
    assert list(motive.side.clients) == [alive.getsockname()]
    assert motive.side.counts["timed_out"] == 1
    motive.ask(client, natnet.BareMessage(KIND.KEEPALIVE))  # it has to connect again
    assert len(motive.side.clients) == 1


def test_a_client_is_announced_once_by_its_address():
    motive = Motive()
    client = motive.client()
    for _ in range(2):
        motive.ask(client, natnet.Connect())
    host, port = client.getsockname()
    assert motive.greeted == [f"{host}:{port}"]
    motive.ask(motive.client(), natnet.Connect())
    assert len(motive.greeted) == 2


def test_a_multicast_server_sends_to_its_group_whoever_connects():
    motive = Motive("lab.camera.transport=multicast")
    group = motive.network.bound_socket(motive.side.section.group, 1601)
    client = motive.client()
    assert len(motive.ask(client, natnet.Connect())) == 1
    motive.run(0.5)
    assert len(motive.heard(group)) == pytest.approx(60, abs=2)
    assert motive.heard(client) == []
    assert motive.side.clients == {}


@pytest.mark.parametrize(
    ("version", "asked", "keeps", "expected"),
    [
        ("4.1", natnet.Connect(natnet.Version(3, 0), pinned=True), False, (3, 0)),
        ("4.1", natnet.Connect(natnet.Version(4, 1), pinned=True), False, (4, 1)),
        ("4.1", natnet.Connect(natnet.Version(4, 2), pinned=True), False, (4, 1)),  # newer
        ("4.1", natnet.Connect(natnet.Version(3, 0)), False, (4, 1)),  # it does not insist
        ("4.1", natnet.Connect(natnet.Version(3, 0), pinned=True), True, (4, 1)),
        ("3.1", natnet.Connect(natnet.Version(3, 0), pinned=True), False, (3, 1)),
    ],
)
def test_a_client_may_choose_an_older_protocol_of_a_server_since_4_0(
    version, asked, keeps, expected
):
    motive = Motive(version=version, keeps_version=keeps)
    client = motive.client()
    motive.ask(client, asked)
    assert motive.side.clients[client.getsockname()].version == expected


def test_questions_are_answered_to_anybody():
    motive = Motive(unit_mm=10.0)
    client = motive.client()
    (unit,) = motive.ask(client, natnet.NatNetRequest("UnitsToMillimeters"))
    (axis,) = motive.ask(client, natnet.NatNetRequest("UpAxis"))
    (other,) = motive.ask(client, natnet.NatNetRequest("FrameRate"))
    (model,) = motive.ask(client, natnet.BareMessage(KIND.REQUEST_MODELDEF))
    assert struct.unpack("<f", unit.payload) == (10.0,)
    assert struct.unpack("<i", axis.payload) == (natnet.UpAxis.Y,)
    assert other == natnet.BareMessage(KIND.UNRECOGNIZED)
    assert model.bodies == (("Green", 1), ("blue", 7))
    assert motive.side.counts["models asked"] == 1
    assert motive.side.clients == {}


def test_a_server_may_know_neither_its_axis_nor_its_models():
    motive = Motive(knows_up_axis=False, answers_models=False)
    client = motive.client()
    unknown = [natnet.BareMessage(KIND.UNRECOGNIZED)]
    assert motive.ask(client, natnet.NatNetRequest("UpAxis")) == unknown
    assert motive.ask(client, natnet.BareMessage(KIND.REQUEST_MODELDEF)) == []
    assert motive.ask(client, natnet.BareMessage(KIND.KEEPALIVE)) == []


def test_an_echo_states_the_servers_time_and_its_clock_ticks_in_100_ns():
    motive = Motive()
    client = motive.client()
    (first,) = motive.ask(client, natnet.EchoRequest(123))
    motive.run(2.0)
    (second,) = motive.ask(client, natnet.EchoRequest(124))
    assert (first.client, second.client) == (123, 124)
    assert second.server - first.server == 2 * 10_000_000


def test_jumps_of_the_servers_clock_and_its_other_errors_add_up():
    motive = Motive()
    start = motive.side.ticks(0)
    jump = act(motive.side.acting, "clock_jump", by=0.5)
    act(motive.side.acting, "clock_jump", by=0.25)
    motive.side.clock_errors += [lambda when_ns: when_ns // 10, lambda when_ns: SECOND]
    assert motive.side.ticks(0) - start == 17_500_000
    assert motive.side.ticks(SECOND) - start == 10_000_000 + 17_500_000 + 1_000_000
    motive.side.acting.remove(jump)
    assert motive.side.ticks(0) - start == 12_500_000


def test_garbage_is_counted_and_not_answered():
    motive = Motive()
    client = motive.client()
    assert motive.ask(client, b"\x02\0\xff\xff") == []
    assert motive.side.close()["refused"] == 1


def test_a_server_that_is_gone_answers_nothing():
    motive = Motive()
    client = motive.client()
    fault = act(motive.side.acting, "no_server")
    assert motive.ask(client, natnet.Connect()) == []
    assert motive.side.clients == {}
    motive.side.acting.remove(fault)
    assert len(motive.ask(client, natnet.Connect())) == 1


@pytest.mark.parametrize(
    ("changed", "edits", "params"), [(False, False, 0), (True, False, 2), (False, True, 4)]
)
def test_a_frame_says_that_models_have_changed_or_are_edited(changed, edits, params):
    motive = Motive(models_changed=changed)
    client = motive.client()
    if edits:
        act(motive.side.acting, "edit_mode")
    motive.ask(client, natnet.Connect())
    motive.run(0.02)
    frame = motive.heard(client)[0]
    assert frame.params == params
    assert [body.id for body in frame.bodies] == [1, 7]


def test_as_many_frames_are_damaged_as_the_fault_says():
    motive = Motive()
    client = motive.client()
    motive.ask(client, natnet.Connect())
    fault = act(motive.side.acting, "bad_datagrams", share=1.0)
    motive.run(0.1)
    good = 0
    with suppress(BlockingIOError):
        while True:
            data, _ = client.recvfrom(65_535)
            with suppress(Exception):
                frame = parse_datagram(data, motive.side.own_version)
                good += len(frame.bodies) == 2
    assert good <= 1
    motive.side.acting.remove(fault)
    motive.run(0.1)
    assert len(motive.heard(client)) >= 11


def test_the_origin_of_the_system_is_that_of_the_spec_whatever_its_unit():
    in_cm = SPEC.replace("length: mm", "length: cm").replace("radius: 40", "radius: 4")
    in_cm = in_cm.replace("speed: 180", "speed: 18").replace("speed: 200", "speed: 20")
    origin = "lab.camera.origin=[30, -20]"
    assert Motive(origin).side.view.origin == pytest.approx((30.0, -20.0))
    assert Motive(origin, spec=in_cm).side.view.origin == pytest.approx((300.0, -200.0))

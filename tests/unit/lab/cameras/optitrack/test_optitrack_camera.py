"""Tests of the camera's requests: what it asks a server for, how often, and until when."""

import struct
from collections import deque
from itertools import pairwise
from types import SimpleNamespace

import pytest

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.errors import AbortError
from tetractl.lab.cameras.optitrack import natnet, wire
from tetractl.lab.cameras.optitrack.camera import (
    INITIAL_ECHOES,
    REQUEST_INTERVAL_NS,
    OptitrackCamera,
)
from tetractl.lab.cameras.optitrack.natnet import MessageKind, UpAxis, Version
from tetractl.lab.cameras.optitrack.section import OptitrackSection
from tetractl.lab.cameras.optitrack.stream import UNITS_SETTING, UP_AXIS_SETTING

SERVER = "192.168.1.5"
COMMANDS = 1510
DATA = 1511
HZ = 1_000_000
V41 = Version(4, 1)
STEP_NS = SECOND // 100


class Steps(VirtualClock):
    """A clock that gives the camera a turn every 10 ms, and lets a server stream then."""

    def __init__(self):
        super().__init__()
        self.turns = []

    def sleep_until(self, when):
        while self.now() < when:
            super().sleep_until(min(when, self.now() + STEP_NS))
            for turn in list(self.turns):
                turn()


class Server:
    """Stands for a camera server: it answers what `answers` says, and streams frames.

    `asked` are the requests that came, each with its time.
    """

    def __init__(self, version=V41, streams=True, name="Motive", clock_hz=HZ):
        self.clock = Steps()
        self.version = version
        self.streams = streams
        self.name = name
        self.clock_hz = clock_hz
        self.silent_about = set()
        self.bodies = (("G", 11), ("B", 12))
        self.params = 0
        self.streamed = (11, 12)
        self.asked = []
        self.inbox = deque()
        self.sockets = []
        self.number = 0
        self.host = SERVER
        self.data_port = DATA
        self.woken = 0

    # ---- the socket of the camera ----

    def make_socket(self, turn):
        made = SimpleNamespace(
            bind=lambda address: None,
            setsockopt=lambda *_: None,
            setblocking=lambda flag: None,
            sendto=self.take,
            recvfrom=lambda size: self.next_for(made),
            close=lambda: self.sockets.remove(made),
        )
        self.sockets.append(made)
        return made

    def next_for(self, reading):
        if reading is not self.sockets[0] or not self.inbox:
            raise BlockingIOError
        return self.inbox.popleft()

    def take(self, data, address):
        assert address == (SERVER, COMMANDS)
        kind, payload = wire.split_datagram(data)
        what = payload.rstrip(b"\0").decode() if kind is MessageKind.REQUEST else kind.name
        self.asked.append((what, self.clock.now()))
        if what not in self.silent_about:
            self.answer(what, payload)

    def answer(self, what, payload):
        if what == "CONNECT":
            rest = struct.pack("<QH5x", self.clock_hz, DATA)
            info = wire.pack_sender(self.name, self.version) + rest
            self.say(MessageKind.SERVER_INFO, info)
        elif what == UP_AXIS_SETTING:
            self.say(MessageKind.RESPONSE, struct.pack("<i", 2))
        elif what == UNITS_SETTING:
            self.say(MessageKind.RESPONSE, struct.pack("<f", 1000.0))
        elif what == "REQUEST_MODELDEF":
            rows = [name.encode() + b"\0" + struct.pack("<ii", k, -1) for name, k in self.bodies]
            sets = b"".join(struct.pack("<ii", 1, len(row)) + row for row in rows)
            self.say(MessageKind.MODELDEF, struct.pack("<i", len(rows)) + sets)
        elif what == "ECHO_REQUEST":
            ticks = struct.pack("<Q", self.clock.now() // 1000)
            self.say(MessageKind.ECHO_RESPONSE, payload + ticks)

    def say(self, kind, payload, port=COMMANDS, host=None):
        self.inbox.append((wire.pack_datagram(kind, payload), (host or self.host, port)))

    def stream(self):
        if not self.streams:
            return
        self.number += 1
        bodies = b"".join(
            struct.pack("<i7ffH", k, 1, 2, 3, 0, 0, 0, 1, 0.5, 1) for k in self.streamed
        )
        sections = struct.pack("<6i", 0, 0, 0, 0, len(self.streamed), len(bodies)) + bodies
        times = (0, 0, 0.0, self.clock.now() // 1000, 0, 0, 0, 0, self.params, 0)
        suffix = struct.pack("<IIdQQQIIHi", *times)
        payload = struct.pack("<i", self.number) + sections + bytes(40) + suffix
        self.say(MessageKind.FRAME, payload, self.data_port)

    # ---- the camera ----

    def camera(self, **fields):
        robots = [{"name": "green", "body": "G"}, {"name": "blue", "body": "B"}]
        section = {
            "type": "optitrack",
            "server": SERVER,
            "interface": "192.168.1.2",
            "transport": "unicast",
            "robots": robots,
        }
        setup = SimpleNamespace(names=("green", "blue"), metres=0.001)
        made = OptitrackCamera(
            OptitrackSection.model_validate(section | fields),
            setup,
            self.clock,
            self.wake,
            self.make_socket,
        )
        self.clock.turns = [self.stream, made.turn]
        return made

    def wake(self):
        self.woken += 1

    def times(self, what):
        """When it was asked for this [s]."""
        return [now_ns / SECOND for asked, now_ns in self.asked if asked == what]

    def run(self, seconds):
        self.clock.sleep_until(self.clock.now() + round(seconds * SECOND))


def gaps(times_s):
    return [round(after - before, 2) for before, after in pairwise(times_s)]


def test_a_camera_connects_once_all_is_known_and_gives_every_frame_once():
    server = Server()
    with server.camera() as camera:
        first = camera.frames()
        assert [frame.number for frame in first] == list(range(first[0].number, server.number + 1))
        assert [pose.x for pose in first[-1].poses] == [1000, 1000]
        assert camera.frames() == []
        server.run(0.1)
        assert len(camera.frames()) == 10
        assert server.woken >= len(first) + 10
        health = camera.check()
        assert (health.problems, health.warnings) == ((), ())
        assert not health.emulated
        assert health.facts["clock_round_trip_ms"] != "unknown"
        assert camera.stream.up_axis is UpAxis.Z
    assert server.sockets == []
    assert server.asked[-1][0] == "DISCONNECT"


def test_a_server_is_asked_once_for_what_it_answers_and_goes_on_with_echoes():
    server = Server()
    with server.camera() as camera:
        server.run(10)
        for what in ("CONNECT", UP_AXIS_SETTING, UNITS_SETTING, "REQUEST_MODELDEF"):
            assert len(server.times(what)) == 1, what
        assert set(gaps(server.times("KEEPALIVE"))) == {1.0}
        echoes = gaps(server.times("ECHO_REQUEST"))
        assert set(echoes[: INITIAL_ECHOES - 1]) == {0.02}
        assert set(echoes[INITIAL_ECHOES:]) == {0.5}
        assert camera.stream.counts.unrequested == 0


def test_in_multicast_nobody_keeps_the_stream_alive():
    server = Server()
    with server.camera(transport="multicast"):
        server.run(3)
    assert server.times("KEEPALIVE") == []


def test_an_unanswered_request_is_repeated_after_a_quarter_second():
    server = Server()
    server.silent_about = {"CONNECT"}
    with pytest.raises(AbortError):
        server.camera(connect=2).__enter__()
    assert set(gaps(server.times("CONNECT"))) == {REQUEST_INTERVAL_NS / SECOND}
    assert len(server.times("CONNECT")) in (8, 9)
    assert {asked for asked, _ in server.asked} == {"CONNECT", "DISCONNECT"}
    assert server.sockets == []


def test_a_server_that_ignores_the_unit_is_asked_four_times_and_warned_of():
    server = Server()
    server.silent_about = {UNITS_SETTING}
    with server.camera() as camera:
        server.run(5)
        assert len(server.times(UNITS_SETTING)) == 4
        assert any("metres are assumed" in warning for warning in camera.check().warnings)


def test_a_stated_axis_is_not_asked_for_and_one_that_nobody_states_is_needed():
    server = Server()
    with server.camera(up_axis="y") as camera:
        assert server.times(UP_AXIS_SETTING) == []
        assert camera.stream.up_axis is UpAxis.Y
    server = Server()
    server.silent_about = {UP_AXIS_SETTING}
    with pytest.raises(AbortError):
        server.camera(connect=1).__enter__()


def test_models_that_keep_changing_are_asked_for_ever_less_often_and_soon_after_a_quiet_time():
    server = Server()
    with server.camera():
        server.params = 2
        server.run(24)
        waits = gaps(server.times("REQUEST_MODELDEF"))
        assert waits[-1] == 8.0
        assert waits[1:] == sorted(waits[1:])
        server.params = 0
        server.run(9)
        asked = len(server.times("REQUEST_MODELDEF"))
        server.run(5)
        assert len(server.times("REQUEST_MODELDEF")) == asked, "nothing changes"
        server.params = 2
        server.run(0.3)
        assert len(server.times("REQUEST_MODELDEF")) > asked


def test_models_are_asked_for_while_a_robots_body_is_missing():
    server = Server()
    with server.camera() as camera:
        server.streamed = (11,)
        server.run(2)
        assert len(server.times("REQUEST_MODELDEF")) > 2
        assert camera.check().problems


def test_a_server_without_names_is_refused_if_a_robot_is_named_and_not_if_it_is_numbered():
    server = Server()
    server.silent_about = {"REQUEST_MODELDEF"}
    with pytest.raises(AbortError):
        server.camera(connect=1).__enter__()
    server = Server()
    server.silent_about = {"REQUEST_MODELDEF"}
    numbered = [{"name": "green", "body": 11}, {"name": "blue", "body": 12}]
    with server.camera(connect=1, robots=numbered) as camera:
        assert camera.frames()[-1].poses[0].x == 1000


@pytest.mark.parametrize("version", [Version(2, 5), Version(2, 6)])
def test_a_server_that_does_not_say_which_bodies_are_tracked_is_refused(version):
    server = Server(version, streams=False)
    with pytest.raises(AbortError) as caught:
        server.camera(connect=1).__enter__()
    assert ("would look like a robot" in caught.value.message) is (version < natnet.OLDEST)


def test_a_server_that_streams_nothing_is_refused():
    server = Server(streams=False)
    with pytest.raises(AbortError):
        server.camera(connect=1).__enter__()
    assert server.clock.now() == pytest.approx(SECOND, rel=0.1)


def test_a_server_that_stops_streaming_while_it_is_checked_is_refused():
    server = Server()
    camera = server.camera(connect=1)
    server.clock.turns.append(lambda: setattr(server, "streams", server.number < 3))
    with pytest.raises(AbortError, match="has sent no new frames for 1 s"):
        camera.__enter__()


def test_a_server_without_a_clock_is_warned_of_and_not_asked_for_its_time():
    server = Server(clock_hz=0)
    with server.camera() as camera:
        server.run(1)
        assert server.times("ECHO_REQUEST") == []
        health = camera.check()
        assert "does not report its clock" in health.warnings[0]
        assert health.facts["clock_round_trip_ms"] == "unknown"


@pytest.mark.parametrize(("version", "warned"), [(Version(4, 3), False), (Version(4, 4), True)])
def test_a_newer_protocol_is_read_as_the_newest_known_and_warned_of(version, warned):
    server = Server(version)
    with server.camera() as camera:
        assert bool(camera.check().warnings) is warned


def test_a_pinned_version_is_requested_in_unicast_alone():
    for transport, pinned in [("unicast", Version(3, 1)), ("multicast", None)]:
        server = Server()
        camera = server.camera(transport=transport, version="3.1")
        assert camera._requested_version == pinned


def test_datagrams_of_other_hosts_and_ports_change_nothing():
    server = Server()
    with server.camera() as camera:
        camera.frames()
        server.data_port = DATA + 5
        server.run(0.1)
        assert camera.frames() == []
        server.data_port = DATA
        server.host = "192.168.1.66"
        server.run(0.1)
        assert camera.frames() == []
        server.host = SERVER
        server.run(0.1)
        assert len(camera.frames()) == 10
        assert camera.damaged == 0


def test_a_camera_that_is_closed_may_be_closed_again_and_takes_no_turn():
    server = Server()
    camera = server.camera()
    camera.turn()
    assert server.asked == [], "it is not open"
    with camera:
        pass
    camera.__exit__()
    count = len(server.asked)
    camera.turn()
    assert len(server.asked) == count
    assert [asked for asked, _ in server.asked].count("DISCONNECT") == 1


def test_an_address_that_this_computer_does_not_have_is_named():
    server = Server()
    make_socket = server.make_socket

    def refuse(address):
        raise OSError(99, "Cannot assign requested address")

    def make_refusing(turn):
        made = make_socket(turn)
        made.bind = refuse
        return made

    server.make_socket = make_refusing
    with pytest.raises(AbortError, match="cannot receive camera frames on the address 192"):
        server.camera().__enter__()
    assert server.sockets == []


def test_a_camera_that_was_never_opened_can_be_closed_and_says_nothing():
    server = Server()
    server.camera().__exit__()
    assert server.asked == []

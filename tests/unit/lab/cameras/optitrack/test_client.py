"""The NatNet client against the emulated Motive, over real UDP on the loopback."""

import socket
import threading
from contextlib import contextmanager

import pytest
from support.emulated_lab import SPEC, emulated
from support.terminal import PATIENCE_S

from tetractl.core.clock import SECOND, MonotonicClock
from tetractl.core.errors import AbortError
from tetractl.emulate.optitrack.server_wire import pack_answer
from tetractl.experiment.load import parse_spec
from tetractl.experiment.plants import lab_of
from tetractl.lab.cameras.optitrack.camera import OptitrackCamera
from tetractl.lab.cameras.optitrack.messages import (
    BodyName,
    EchoResponse,
    ModelDef,
    NatNetFrame,
    RigidBody,
    ServerInfo,
    Ticks,
    Version,
)

V41 = Version(4, 1)
SHORT = 0.3  # s: what never comes is waited for in full


class Changed:
    """Woken by each camera frame; `until` waits for a condition that frames bring about."""

    def __init__(self):
        self.event = threading.Event()

    def until(self, condition):
        clock = MonotonicClock()
        while not condition():
            assert clock.now() < PATIENCE_S * SECOND, "it did not happen"
            self.event.wait(0.005)
            self.event.clear()


@contextmanager
def motive(folder, script="", *sets, clock=None, connect=5.0, robots=None):
    """An emulated Motive that runs in a thread, and a camera for it that is not connected yet."""
    spec = SPEC if robots is None else SPEC.replace(ROBOTS, robots)
    emulation = f"emulation: {{camera: {{{script}}}}}" if script else "row: ''"
    with emulated(folder, *sets, spec=spec, script=emulation) as lab:
        settings = (*sets, f"lab.camera.command_port={lab.camera.motive.command_port}")
        if "lab.camera.transport=multicast" in sets:
            settings += (f"lab.camera.data_port={lab.camera.motive.data_port}",)
        loaded = parse_spec(spec, "spec", (*settings, f"lab.camera.connect={connect}"))
        section = lab_of(loaded.experiment, "spec").camera
        changed = Changed()
        camera = OptitrackCamera(
            section,
            loaded.experiment.setup,
            clock or MonotonicClock(),
            wake=changed.event.set,
        )
        thread = threading.Thread(target=lab.run)
        thread.start()
        try:
            yield lab, camera, changed
        finally:
            camera.__exit__(None, None, None)
            lab.loop.end()
            thread.join()


ROBOTS = "robots: [{name: green, body: Green}, {name: blue, body: 7}]"


def refusal(folder, script="", *sets, connect=SHORT, **options):
    """The error of a camera that cannot connect, and its hint."""
    with (
        motive(folder, script, *sets, connect=connect, **options) as (_, camera, _),
        pytest.raises(AbortError) as caught,
        camera,
    ):
        pass
    return str(caught.value), caught.value.hint


def own_address(camera):
    return camera.client._sockets[0].getsockname()


def stray(number, x=0.1, version=V41):
    """A forged frame that shows green and blue elsewhere."""
    bodies = tuple(RigidBody(i, (x, 0.06, -x), (0, 0, 0, 1), True) for i in (1, 7))
    return pack_answer(NatNetFrame(number, bodies, ticks=Ticks(0, 0, 0)), version)


def test_frames_of_another_port_of_the_servers_address_are_dropped(tmp_path):
    """Regression: any process on the server's address was believed, and could walk a robot off."""
    with (
        motive(tmp_path) as (_, camera, changed),
        camera,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        stranger.bind(("127.0.0.1", 0))
        changed.until(lambda: camera.newest.poses[0] is not None)
        camera.frames()  # the first may have come before the names of the bodies
        for step in range(50):
            ahead = camera.newest.number + 1
            stranger.sendto(stray(ahead, 0.1 + 0.033 * step), own_address(camera))
        refused = camera.client.senders.refused
        changed.until(lambda: refused.total() == 50)
        came = camera.stream.counts.frames
        changed.until(lambda: camera.stream.counts.frames > came + 5)
        for frame in camera.frames():
            assert frame.poses[0].x == pytest.approx(500, abs=1)
        assert camera.damaged == 0
        (warning,) = camera.check().warnings
        port = stranger.getsockname()[1]
        assert warning == (
            "50 datagrams came from elsewhere than the camera server and were dropped, most of "
            f"them from 127.0.0.1:{port}"
        )


@pytest.mark.parametrize("which", ["command", "data"])
def test_answers_that_were_not_asked_for_are_dropped_even_from_the_servers_port(tmp_path, which):
    with motive(tmp_path) as (lab, camera, changed), camera:
        model, info = camera.stream.model, camera.stream.info
        offset = camera.stream.sync.to_host(0)
        sender = getattr(lab.camera.motive, which)
        forged = (
            ServerInfo("else", (1, 0, 0, 0), (3, 0, 0, 0), 10**7, 1511, False, (0, 0, 0, 0)),
            ModelDef((BodyName("Green", 7),)),
            EchoResponse(12345, 1),
        )

        def send():
            for message in forged:
                sender.sendto(pack_answer(message, V41), own_address(camera))

        lab.timeline.at(0, send)
        counted = (
            (lambda: camera.stream.counts.unasked)
            if which == "command"
            else camera.client.senders.refused.total
        )
        changed.until(lambda: counted() == 3)
        assert (camera.stream.model, camera.stream.info) == (model, info)
        assert camera.stream.sync.to_host(0) == pytest.approx(offset, abs=5_000_000)
        assert camera.damaged == 0
        assert len(camera.check().warnings) == 1


def test_in_multicast_the_port_of_the_first_frame_stays(tmp_path):
    sets = (
        "lab.camera.transport=multicast",
        "lab.camera.group=239.255.42.97",
        "lab.camera.interface=127.0.0.1",
    )
    with (
        motive(tmp_path, "", *sets) as (lab, camera, changed),
        camera,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        assert camera.client.senders.frames_port == lab.camera.motive.data.getsockname()[1]
        stranger.bind(("127.0.0.1", 0))
        stranger.setsockopt(
            socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1")
        )
        stranger.sendto(
            stray(camera.newest.number + 1), ("239.255.42.97", lab.camera.motive.data_port)
        )
        changed.until(lambda: camera.client.senders.refused.total() == 1)


def test_a_server_that_keeps_its_own_version_is_told_from_one_that_does_not_stream(tmp_path):
    """Regression: it said that no frames come, while 120 a second did."""
    said, hint = refusal(tmp_path, "version: 4.2, keeps_version: true", "lab.camera.version=3.1")
    assert "answers, but not in protocol 3.1, which lab.camera.version asks for: " in said
    assert "frames came in 0.3 s, which read as protocol 4.2" in said
    assert hint == "leave lab.camera.version out: the server keeps to its own, 4.2"


def test_frames_of_the_servers_second_address_are_told_from_none(tmp_path):
    said, hint = refusal(tmp_path, "frames_from: 127.0.0.2")
    assert "answers, but its frames come from another address: " in said
    assert "frames came from 127.0.0.2:" in said
    assert said.endswith("in 0.3 s, which read as protocol 4.1")
    assert hint == (
        "set lab.camera.server to 127.0.0.2, or in Motive the local interface to 127.0.0.1"
    )


def test_frames_of_another_layout_than_the_server_tells_are_told(tmp_path):
    with motive(tmp_path, connect=SHORT) as (lab, camera, _):
        lab.camera.motive.trouble.version = Version(3, 0)
        with pytest.raises(AbortError, match=r"tells protocol 4\.1, but is not underst") as e:
            camera.__enter__()
    assert str(e.value).endswith("which read as protocol 3.0")
    assert "set lab.camera.version" in e.value.hint


def test_no_frames_at_all_is_still_said(tmp_path):
    with motive(tmp_path, connect=SHORT) as (lab, camera, _):
        lab.camera.motive.trouble.no_frames = True
        with pytest.raises(AbortError, match=r"answers, but no frames come \(0.3 s\)"):
            camera.__enter__()


def test_a_server_that_answers_from_another_address_is_named(tmp_path):
    with (
        motive(tmp_path, connect=SHORT) as (lab, camera, _),
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as second,
    ):
        second.bind(("127.0.0.3", 0))
        lab.camera.motive.trouble.silent = True
        info = ServerInfo("Motive", (3, 0, 0, 0), (4, 1, 0, 0), 10**7, 1511, False, (0, 0, 0, 0))
        camera.client.open()
        second.sendto(pack_answer(info), ("127.0.0.1", own_address(camera)[1]))
        with pytest.raises(AbortError, match=r"but one does from 127\.0\.0\.3:") as caught:
            camera.client.wait_connected(SHORT)
    assert caught.value.hint.startswith("set lab.camera.server to 127.0.0.3")


def test_names_that_the_server_does_not_tell_have_their_own_message(tmp_path):
    said, hint = refusal(tmp_path, "answers_models: false")
    assert "the names 'Green' are not known" in said
    assert "it does not answer when asked for its rigid bodies (0.3 s)" in said
    assert hint.endswith("frames hold the ids 1, 7")


def test_bodies_given_by_their_ids_need_no_names(tmp_path):
    ids = "robots: [{name: green, body: 1}, {name: blue, body: 7}]"
    quiet = motive(tmp_path, "answers_models: false", robots=ids, connect=SHORT)
    with quiet as (_, camera, _), camera:
        assert all(camera.newest.poses)
        assert camera.check().problems == ()


def test_a_protocol_without_tracking_flag_has_its_own_message(tmp_path):
    said, hint = refusal(tmp_path, "version: 2.5")
    assert said.startswith("the camera server speaks protocol 2.5, whose frames do not tell which")
    assert "NatNet 2.6 or later" in hint


def test_a_name_that_is_not_known_comes_with_those_that_are(tmp_path):
    with motive(tmp_path, "robots: [{name: green, body: Greeen}]") as (_, camera, _), camera:
        (problem,) = camera.check().problems
        assert problem == (
            "the cameras know no rigid body 'Green', wanted for green; did you mean 'Greeen'?; "
            "they have 'Greeen' (id 1); 'blue' (id 7)"
        )
        assert camera.check().facts["rigid_bodies"] == "'Greeen' (id 1); 'blue' (id 7)"


def test_an_id_that_is_not_known_comes_with_the_nearest(tmp_path):
    with motive(tmp_path) as (lab, camera, changed), camera:
        lab.camera.hidden.add(7)
        lab.camera.motive.server._names = (BodyName("Green", 1), BodyName("hand", 9))
        changed.until(lambda: camera.stream.missing() == [7] and len(camera.stream.seen) == 1)
        changed.until(lambda: "hand" in camera.stream.model.ids())
        (problem,) = camera.check().problems
        assert "know no rigid body of id 7, wanted for blue; the nearest id is 1;" in problem


def test_a_body_that_is_known_but_not_streamed_is_told_as_that(tmp_path):
    with motive(tmp_path, "robots: [{name: green, streamed: false}]") as (_, camera, _), camera:
        (problem,) = camera.check().problems
        assert problem == (
            "the cameras do not stream the rigid body 'Green', wanted for green: switch it on in "
            "Motive; they have 'Green' (id 1), not streamed; 'blue' (id 7)"
        )


@pytest.mark.parametrize("version", ["4.4", "4.5"])
def test_a_newer_version_with_longer_descriptions_is_read_and_warned_of(tmp_path, version):
    """Regression: a description that grew threw the whole list of names away."""
    with motive(tmp_path, f"version: {version}") as (_, camera, changed), camera:
        assert camera.stream.model.ids() == {"Green": 1, "blue": 7}
        changed.until(lambda: all(camera.newest.poses))
        found = camera.check()
        assert found.problems == ()
        assert f"protocol {version} is newer than those known here; it is read as 4.3" in (
            found.warnings
        )
        assert camera.damaged == 0


class SetClock:
    """A clock that stands until it is set."""

    def __init__(self):
        self.time_ns = 10 * SECOND

    def now(self):
        return self.time_ns

    def sleep_until(self, when):
        self.time_ns = max(self.time_ns, when)


def test_models_that_keep_changing_are_asked_for_ever_less_often(tmp_path):
    """Regression: four times a second, for as long as the bit lasted."""
    clock = SetClock()
    script = "models_changed: true, rate: 500"
    with motive(tmp_path, script, clock=clock) as (lab, camera, changed):
        camera.client.open()
        counts = lab.camera.motive.counts
        changed.until(lambda: camera.stream.model is not None and camera.stream.changing)
        before = counts.models_asked
        for _ in range(240):  # a minute
            clock.time_ns += SECOND // 4
            came = camera.stream.counts.frames
            changed.until(lambda came=came: camera.stream.counts.frames >= came + 3)
        assert 5 <= counts.models_asked - before <= 13


def test_a_body_that_gets_its_name_is_found(tmp_path):
    with (
        motive(tmp_path, "robots: [{name: green, body: Greeen}]") as (lab, camera, changed),
        camera,
    ):
        assert camera.newest.poses[0] is None
        lab.camera.motive.server._names = (BodyName("Green", 1), BodyName("blue", 7))
        changed.until(lambda: camera.newest.poses[0] is not None)
        assert camera.check().problems == ()

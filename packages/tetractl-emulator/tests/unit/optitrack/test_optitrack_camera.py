"""Tests of the NatNet client against the emulated Motive, datagram by datagram."""

import re
from contextlib import contextmanager

import pytest
from testkit.emulator.acting import act
from testkit.emulator.virtual_lab import Joined, virtual_lab
from testkit.lab_specs import SPEC
from tetractl_emulator.optitrack.natnet_server import pack_answer

from tetractl.core.clock import SECOND
from tetractl.core.errors import AbortError
from tetractl.lab.cameras.optitrack import natnet

pytestmark = pytest.mark.slow

V41 = natnet.Version(4, 1)
SHORT = 0.3  # s: what never comes is waited for in full
ROBOTS = "robots: [{name: green, body: Green}, {name: blue, body: 7}]"


@contextmanager
def motive(folder, script="", *sets, connect=5.0, robots=ROBOTS):
    """An emulated Motive, a camera for it that is not connected yet, and the clock of both."""
    spec = SPEC.replace(ROBOTS, robots)
    script = f"emulation: {{camera: {{{script}}}}}" if script else ""
    sets = (*sets, f"lab.camera.connect={connect}")
    with virtual_lab(folder, *sets, spec=spec, script=script) as lab:
        experiment = lab.spec.experiment
        camera = experiment.plant.camera.build(experiment.setup, lab.clock, lambda: None)
        yield lab.emulation, camera, lab.clock
        camera.__exit__()


def refusal(folder, script="", *sets):
    """The error of a camera that cannot connect, and its hint."""
    with (
        motive(folder, script, *sets, connect=SHORT) as (_, camera, _),
        pytest.raises(AbortError) as caught,
        camera,
    ):
        pass
    return caught.value.message, caught.value.hint


def own_address(camera):
    return camera._sockets[0].getsockname()


def stranger_of(address="127.0.0.1"):
    """A socket that is not the server's."""
    return Joined.lab.wires.bound(address, 0)


def stray(number, x=0.1):
    """A forged frame that shows green and blue elsewhere."""
    bodies = tuple(natnet.RigidBody(i, (x, 0.06, -x), (0, 0, 0, 1), True) for i in (1, 7))
    return pack_answer(natnet.NatNetFrame(number, bodies), V41)


def test_frames_of_another_port_of_the_servers_address_are_dropped(tmp_path):
    """Regression: any process on the server's address was trusted, and could walk a robot off."""
    with motive(tmp_path) as (_, camera, clock), camera:
        stranger = stranger_of()
        assert clock.wait(lambda: camera.stream.newest.poses[0] is not None)
        camera.frames()  # the first may have come before the names of the bodies
        for step in range(50):
            ahead = camera.stream.newest.number + 1
            stranger.sendto(stray(ahead, 0.1 + 0.033 * step), own_address(camera))
        refused = camera.senders.refused
        assert clock.wait(lambda: refused.total() == 50)
        came = camera.stream.counts.frames
        assert clock.wait(lambda: camera.stream.counts.frames > came + 5)
        for frame in camera.frames():
            assert frame.poses[0].x == pytest.approx(500, abs=1)
        assert camera.damaged == 0
        (warning,) = camera.check().warnings
        port = stranger.getsockname()[1]
        assert warning == (
            "50 datagrams did not come from the camera server and were dropped; most came "
            f"from 127.0.0.1:{port}"
        )


@pytest.mark.parametrize(
    ("script", "said", "hint"),
    [
        # regression: it said that no frames come, while 120 a second did
        (
            "version: 4.2, keeps_version: true",
            r"not follow protocol 3\.1, which lab.camera.version .* and they fit protocol 4\.2$",
            "remove lab.camera.version, because the server uses its own version, 4.2",
        ),
        (
            "frames_from: 127.0.0.2",
            r"from another address: \d+ frames came from 127\.0\.0\.2:.* within 0.3 s, and they",
            "set lab.camera.server to 127.0.0.2, or set the local interface in Motive to 127.0.0.1",
        ),
        (
            "answers_models: false",
            r"the names 'Green' cannot be found.* for its rigid bodies within 0.3 s",
            "frames contain the ids 1, 7",
        ),
        (
            "knows_up_axis: false",
            "does not report which of its axes",
            "set lab.camera.up_axis to y or z",
        ),
        ("version: 2.5", r"^the camera server uses protocol 2\.5, whose", "NatNet 2.6 or later"),
    ],
)
def test_a_camera_that_cannot_connect_says_what_came_and_what_to_set(tmp_path, script, said, hint):
    pinned = ("lab.camera.version=3.1",) if "keeps" in script else ()
    message, advice = refusal(tmp_path, script, *pinned)
    assert re.search(said, message)
    assert hint in advice


def test_a_server_that_answers_from_another_address_is_named(tmp_path):
    with motive(tmp_path, connect=SHORT) as (lab, camera, _):
        second = stranger_of("127.0.0.3")
        act(lab.camera.acting, "no_server")
        info = natnet.ServerInfo("Motive", V41, 10**7, 1511)
        camera.open()
        second.sendto(pack_answer(info), own_address(camera))
        with pytest.raises(AbortError, match=r"but one answers from 127\.0\.0\.3:") as caught:
            camera.wait_connected(SHORT)
    assert caught.value.hint.startswith("set lab.camera.server to 127.0.0.3")


@pytest.mark.parametrize(
    ("script", "sets"), [("version: 2.9", ()), ("", ("lab.camera.version=2.9",))]
)
def test_frames_of_version_2_are_dated_by_their_arrival(tmp_path, script, sets):
    with motive(tmp_path, script, *sets) as (_, camera, clock), camera:
        assert clock.wait(lambda: all(camera.stream.newest.poses))
        assert camera.stream.newest.sampled_ns == camera.stream.newest.received_ns
        assert camera.check().facts["natnet"] == "2.9"


def test_an_id_that_is_not_known_comes_with_the_nearest(tmp_path):
    with motive(tmp_path) as (lab, camera, clock), camera:
        (blue,) = (body for body in lab.camera.tracked if body.robot.name == "blue")
        blue.asset.is_streamed = False
        lab.camera.names = (("Green", 1), ("hand", 9))
        assert clock.wait(
            lambda: (
                camera.stream.list_missing_bodies() == [7] and len(camera.stream.streamed_ids) == 1
            )
        )
        assert clock.wait(lambda: "hand" in camera.stream.model.ids())
        (problem,) = camera.check().problems
        assert "has no rigid body with id 7 for blue; the nearest id is 1;" in problem


@pytest.mark.parametrize("version", ["4.4", "4.5"])
def test_a_newer_version_with_longer_descriptions_is_read_and_warned_of(tmp_path, version):
    """Regression: a description that grew threw the whole list of names away."""
    with motive(tmp_path, f"version: {version}") as (_, camera, clock), camera:
        assert camera.stream.model.ids() == {"Green": 1, "blue": 7}
        assert clock.wait(lambda: all(camera.stream.newest.poses))
        health = camera.check()
        assert health.problems == ()
        newer = f"the server's protocol {version} is newer than 4.3"
        assert f"{newer}; its frames are read as protocol 4.3" in health.warnings
        assert camera.damaged == 0


@pytest.mark.long
def test_models_that_keep_changing_are_asked_for_ever_less_often(tmp_path):
    """Regression: four times a second, for as long as the bit lasted."""
    with motive(tmp_path, "models_changed: true, rate: 20") as (lab, camera, clock), camera:
        before = lab.camera.counts["models asked"]
        clock.sleep_until(clock.now() + 60 * SECOND)
        assert 5 <= lab.camera.counts["models asked"] - before <= 13

"""Tests of the server for log viewers, with a real client on a real socket."""

import json
import socket
from urllib.parse import urlsplit

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from testkit import random_trials
from testkit.viewer import PATIENCE_S, PROTOCOL, SUBSCRIPTIONS_FROM, Viewer, deaf
from websockets.exceptions import ConnectionClosedError, InvalidStatus
from websockets.sync.client import connect

from tetractl.core.clock import MonotonicClock
from tetractl.core.errors import UsageError
from tetractl.log.format.channels import CHANNELS, FRAMES, LOG, SCENE, TRANSFORMS, Entry
from tetractl.log.read.salvage import scan
from tetractl.serve.live import BACKLOG_MAX, ServedRun, Viewers
from tetractl.serve.server import LoopbackServer

START_NS = 1_600_000_000_000_000_000


class Live(LoopbackServer):
    """A server with `viewers`."""

    def __init__(self):
        self.viewers = Viewers("test")
        super().__init__(self.viewers)

    def send(self, records):
        for record in records:
            self.viewers.add(record)


@pytest.fixture
def server():
    with Live() as server:
        yield server


def frame(number, size=2000):
    """A message of frames whose log time is so many nanoseconds after the start."""
    return Entry(FRAMES, START_NS + number, START_NS, b"%8d" % number + bytes(size))


def is_of(topic):
    """Whether what came is a message of this topic, or a time."""
    return lambda message: message[0] == topic


def is_of_time(topic, log_ns):
    return lambda message: message[:2] == (topic, log_ns)


def numbers(viewer, topic):
    """The log times of all that came of a topic, in nanoseconds after the start."""
    return [log_ns - START_NS for name, log_ns, _ in viewer.all if name == topic]


def files_by_name(schema):
    return {file.name: file for file in FileDescriptorSet.FromString(schema).file}


def test_topics_and_schemas_are_those_of_a_log(server, tmp_path):
    trial = random_trials.trial(1, steps=1)
    log = scan(random_trials.write(trial, tmp_path / "trial.mcap"))
    with Viewer(server.url) as viewer:
        assert log.channels.keys() <= viewer.channels.keys() == CHANNELS.keys()
        for topic, (channel, schema) in log.channels.items():
            advertised = viewer.channels[topic]
            assert advertised["schemaName"] == schema.name
            assert advertised["encoding"] == channel.message_encoding == "protobuf"
            assert files_by_name(viewer.schema(topic)) == files_by_name(schema.data)


def test_who_comes_late_gets_the_scene_the_poses_and_the_time(server):
    trial = random_trials.trial(1, steps=2)
    observer = ServedRun(server.viewers, MonotonicClock())
    observer.on_start(trial.start)
    observer.on_samples(trial.samples)
    with Viewer(server.url) as viewer:
        viewer.subscribe(SCENE, TRANSFORMS)
        _, scene = viewer.message(SCENE)
        entities = [entity.id for entity in scene.entities]
        assert entities[:3] == ["arena", "obstacle/0", "obstacle/1"]
        log_ns, poses = viewer.message(TRANSFORMS)
        last_received_ns = trial.samples[-1].observation.received_ns
        assert log_ns == trial.start.start_unix_ns + last_received_ns
        assert poses.transforms[0].child_frame_id == "robot/robot 0"
        assert viewer.seen(is_of_time("time", log_ns)) == ("time", log_ns, b"")


def test_the_time_never_runs_back_but_by_a_jump(server):
    with Viewer(server.url) as viewer:
        server.viewers.add(frame(1))
        viewer.subscribe(FRAMES).until(is_of(FRAMES))
        viewer.all.clear()
        for number in (3, 2, 4):
            server.viewers.add(frame(number))
        # not to 1, whose time may have been still to come
        server.viewers.jump(START_NS)
        server.viewers.add(frame(0))
        viewer.seen(is_of_time("time", START_NS))
        viewer.seen(is_of_time(FRAMES, START_NS))  # which waits in another queue
        assert numbers(viewer, "time")[-3:] == [3, 4, 0]
        assert numbers(viewer, FRAMES) == [3, 2, 4, 0]


@pytest.mark.long
def test_a_client_that_does_not_read_delays_nobody_not_even_the_end():
    server = Live()
    frames = 3 * BACKLOG_MAX  # far more than its queue and sockets hold
    with deaf(server.url, len(CHANNELS)) as stuck:
        with Viewer(server.url) as viewer:
            server.viewers.add(frame(0))
            viewer.subscribe(FRAMES).until(is_of(FRAMES))
            viewer.all.clear()
            for first in range(0, frames, 512):
                batch = [frame(number, 8000) for number in range(first, first + 512)]
                server.send(batch)
                viewer.until(is_of_time(FRAMES, START_NS + first + 511))
            assert numbers(viewer, FRAMES) == list(range(frames))
        server.close()
        assert stuck.recv(1)


ACCEPTED = 101
REFUSED = 403


def knock(url, origin=None):
    """Ask for a connection as a page of `origin` or a program might; return the answer's status."""
    return knock_at(url, url, origin)


def knock_at(url, address, origin=None):
    """The same at the host and port of `url`, with another address in the request."""
    place = urlsplit(url)
    door = socket.create_connection((place.hostname, place.port))
    try:
        with connect(
            address, sock=door, origin=origin, subprotocols=[PROTOCOL], close_timeout=0.1
        ) as client:
            assert client.recv(timeout=PATIENCE_S)
            return ACCEPTED
    except InvalidStatus as error:
        assert b"serverInfo" not in error.response.body
        return error.response.status_code


@pytest.mark.parametrize(
    "origin",
    [
        "https://evil.example",
        "http://evil.example:8080",
        "http://localhost.evil.example",
        "http://127.0.0.1@evil.example",
        "null",
        "http://lichtblick.example:8080",
    ],
)
def test_pages_of_other_sites_are_refused_even_with_the_token(server, origin):
    assert knock(server.url, origin) == REFUSED


@pytest.mark.parametrize(
    "origin",
    [
        None,
        "https://app.foxglove.dev",
        "http://localhost:8080",
        "http://127.0.0.1:9000",
        "file://",
    ],
)
def test_programs_and_pages_of_viewers_are_accepted(server, origin):
    assert knock(server.url, origin) == ACCEPTED


def test_other_names_of_this_machine_are_refused(server):
    token = urlsplit(server.url).path
    for host in ("evil.example", "192.168.1.7", "127.0.0.1.evil.example"):
        assert knock_at(server.url, f"ws://{host}:{server.port}{token}") == REFUSED
    assert knock_at(server.url, f"ws://localhost:1{token}") == REFUSED
    assert knock_at(server.url, f"ws://localhost:{server.port}{token}") == ACCEPTED


def test_other_tokens_are_refused(server):
    token = urlsplit(server.url).path
    for path in ("", "/", "/" + "A" * 16, token[:-1], token + "A", token.upper() + "x"):
        assert knock_at(server.url, f"ws://127.0.0.1:{server.port}{path}") == REFUSED


@pytest.mark.parametrize(
    "wrong",
    [
        "no JSON",
        "[" * 60000,
        "[]",
        "{}",
        '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 99}]}',
        '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
        '{"op": "subscribe", "subscriptions": [{"id": "x", "channelId": 1}]}',
        '{"op": "unsubscribe", "subscriptionIds": 1}',
        b"\x03\x00",
        bytes(1 << 17),
    ],
)
def test_what_a_client_says_wrong_ends_its_connection_and_no_other(wrong, capfd):
    with Live() as server, Viewer(server.url) as bystander:
        with Viewer(server.url) as viewer, pytest.raises(ConnectionClosedError):
            viewer.socket.send(wrong)
            viewer.until(lambda message: False)
        server.viewers.add(frame(1))
        bystander.subscribe(FRAMES).until(is_of(FRAMES))
    assert capfd.readouterr().err == ""


def test_what_was_published_last_is_sent_before_the_end():
    server = Live()
    with Viewer(server.url) as viewer:
        server.viewers.add(frame(0))
        viewer.subscribe(FRAMES).until(is_of(FRAMES))
        server.send([frame(number) for number in range(1, 500)])
        server.close()
        viewer.until(is_of_time(FRAMES, START_NS + 499))


def unsubscribe(viewer, topic):
    subscription = SUBSCRIPTIONS_FROM + viewer.channels[topic]["id"]
    viewer.socket.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [subscription]}))


def test_a_port_in_use_is_a_mistake_of_the_user(server):
    with pytest.raises(UsageError, match=f"port {server.port} cannot be used"):
        LoopbackServer(server.viewers, server.port)


def status_of(server, request):
    """How the answer to a request begins, empty if the connection was closed without one."""
    with socket.create_connection(("127.0.0.1", server.port), timeout=PATIENCE_S) as door:
        door.sendall(f"{request}\r\nConnection: close\r\n\r\n".encode())
        return door.makefile("rb").read()[: len("HTTP/1.1 400 ")]


STRANGE = (
    "GET * HTTP/1.1",
    "GET http://[ HTTP/1.1",
    "GET /%ff%00 HTTP/1.1",
    "GET / HTTP/1.1\r\nOrigin: http://[",
    "OPTIONS * HTTP/1.1",
    "POST / HTTP/1.1",
    "GET /{token} HTTP/1.1",
    "GET /{token}/x HTTP/1.1",
)


@pytest.mark.parametrize("request_line", STRANGE)
def test_nothing_else_is_served_and_a_strange_request_prints_nothing(server, capfd, request_line):
    """Regression: a traceback on the operator's terminal."""
    line = request_line.format(token=server.token)
    status = status_of(server, f"{line}\r\nHost: 127.0.0.1:{server.port}")
    assert status in (b"", b"HTTP/1.1 400 ", b"HTTP/1.1 403 ", b"HTTP/1.1 426 ")
    assert capfd.readouterr() == ("", "")


def test_a_server_says_what_it_is_and_that_it_has_a_time(server):
    with Viewer(server.url) as viewer:
        assert viewer.info["name"] == "test"
        assert viewer.info["capabilities"] == ["time"]


def test_lines_of_text_are_not_sent_twice(server):
    server.send([Entry(LOG, START_NS, START_NS, b""), frame(1)])
    with Viewer(server.url) as viewer:
        viewer.subscribe(LOG, FRAMES)
        viewer.until(is_of(FRAMES))
        assert LOG not in [topic for topic, *_ in viewer.all]


def test_viewers_watch_once_one_has_subscribed(server):
    with Viewer(server.url) as viewer:
        assert not server.viewers.watched
        server.viewers.add(frame(1))
        viewer.subscribe(FRAMES).until(is_of(FRAMES))
        assert server.viewers.watched


def test_no_more_is_sent_of_what_a_viewer_gave_up(server):
    with Viewer(server.url) as viewer:
        server.send([frame(1), Entry(TRANSFORMS, START_NS + 1, START_NS, b"")])
        viewer.subscribe(FRAMES).until(is_of(FRAMES))
        unsubscribe(viewer, FRAMES)
        viewer.subscribe(TRANSFORMS).until(is_of(TRANSFORMS))
        server.send([frame(2), Entry(TRANSFORMS, START_NS + 3, START_NS, b"")])
        viewer.until(is_of_time(TRANSFORMS, START_NS + 3))
        assert numbers(viewer, FRAMES) == [1]


def test_each_server_has_its_own_token(server):
    assert server.url.startswith("ws://127.0.0.1:")
    with Live() as second:
        assert second.token != server.token
        assert len(second.token) >= 16


def test_a_strange_request_for_a_connection_prints_nothing(server, capfd):
    status = status_of(server, "GET / HTTP/1.1\r\nUpgrade: websocket\r\nOrigin: http://[")
    assert status in (b"", b"HTTP/1.1 403 ")
    assert capfd.readouterr() == ("", "")

"""The server of log viewers, read by a real client on a real socket."""

import json
import socket
from urllib.parse import urlsplit

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from support import random_trials as made
from support.viewer import PATIENCE_S, PROTOCOL, Viewer, deaf
from websockets.exceptions import ConnectionClosedError, InvalidStatus
from websockets.sync.client import connect

from tetractl.core.clock import MonotonicClock
from tetractl.core.errors import UsageError
from tetractl.log.format.channels import CHANNELS, FRAMES, LOG, SCENE, TRANSFORMS, Entry
from tetractl.log.read.salvage import scan
from tetractl.serve.live import BACKLOG, ServedRun, Viewers
from tetractl.serve.server import LoopbackServer

START_NS = 1_600_000_000_000_000_000


class Live(LoopbackServer):
    """A server with `viewers`."""

    def __init__(self):
        self.viewers = Viewers("test")
        super().__init__(self.viewers)


@pytest.fixture
def server():
    with Live() as server:
        yield server


def frame(number, size=2000):
    return Entry(FRAMES, START_NS + number, START_NS, b"%8d" % number + bytes(size))


def test_topics_and_schemas_are_those_of_a_log(server, tmp_path):
    log = scan(made.write(made.trial(1, steps=1), tmp_path / "trial.mcap"))
    with Viewer(server.url) as viewer:
        assert viewer.info["name"] == "test"
        assert viewer.info["capabilities"] == ["time"]
        assert log.channels.keys() <= viewer.channels.keys() == CHANNELS.keys()
        for topic, (channel, schema) in log.channels.items():
            shown = viewer.channels[topic]
            assert schema
            assert shown["schemaName"] == schema.name
            assert shown["encoding"] == channel.message_encoding == "protobuf"
            files = FileDescriptorSet.FromString(viewer.schema(topic)).file
            logged = FileDescriptorSet.FromString(schema.data).file
            assert {f.name: f for f in files} == {f.name: f for f in logged}


def test_who_comes_late_gets_the_scene_the_poses_and_the_time(server):
    trial = made.trial(1, steps=2)
    observer = ServedRun(server.viewers, MonotonicClock())
    observer.on_start(trial.start)
    observer.on_samples(trial.samples)
    with Viewer(server.url) as viewer:
        viewer.subscribe(SCENE, TRANSFORMS)
        _, scene = viewer.message(SCENE)
        named = [entity.id for entity in scene.entities]
        assert named[:3] == ["arena", "obstacle/0", "obstacle/1"]
        at_ns, poses = viewer.message(TRANSFORMS)
        last = trial.samples[-1].observation.received_ns
        assert at_ns == trial.start.start_unix_ns + last
        assert poses.transforms[0].child_frame_id == "robot/robot 0"
        viewer.seen(lambda got: got == ("time", at_ns, b""))


def test_lines_of_text_are_not_sent_twice(server):
    server.viewers.messages([Entry(LOG, START_NS, START_NS, b""), frame(1)])
    with Viewer(server.url) as viewer:
        viewer.subscribe(LOG, FRAMES)
        viewer.until(lambda got: got[0] == FRAMES)
        assert LOG not in [got[0] for got in viewer.all]


def test_the_time_never_runs_back_but_by_a_jump(server):
    with Viewer(server.url) as viewer:
        assert not server.viewers.watched
        server.viewers.messages([frame(1)])
        viewer.subscribe(FRAMES).until(lambda got: got[0] == FRAMES)
        assert server.viewers.watched
        viewer.all.clear()
        server.viewers.messages([frame(3), frame(2), frame(4)])
        server.viewers.jump(
            START_NS, [frame(0)]
        )  # not to 1, whose time may have been still to come
        for last in ("time", FRAMES):  # they wait in two queues
            viewer.seen(lambda got, last=last: got[:2] == (last, START_NS))
        sent = {
            kind: [got[1] - START_NS for got in viewer.all if got[0] == kind]
            for kind in ("time", FRAMES)
        }
        assert sent["time"][-3:] == [3, 4, 0]
        assert sent[FRAMES] == [3, 2, 4, 0]


def test_a_client_that_does_not_read_delays_nobody_not_even_the_end():
    server = Live()
    with deaf(server.url, len(CHANNELS)) as stuck:
        with Viewer(server.url) as viewer:
            server.viewers.messages([frame(0)])
            viewer.subscribe(FRAMES).until(lambda got: got[0] == FRAMES)
            viewer.all.clear()
            for first in range(0, 3 * BACKLOG, 512):  # far more than its queue and sockets hold
                server.viewers.messages([frame(first + i, 8000) for i in range(512)])
                viewer.until(lambda got, last=first + 511: got[:2] == (FRAMES, START_NS + last))
            got = [one[1] - START_NS for one in viewer.all if one[0] == FRAMES]
            assert got == list(range(3 * BACKLOG))
        server.close()
        assert stuck.recv(1)


def knock(url, netloc=None, path=None, origin=None):
    """Ask for a connection as a page or a program might; return the status of the answer."""
    where = urlsplit(url)
    asked = where._replace(netloc=netloc or where.netloc, path=where.path if path is None else path)
    door = socket.create_connection((where.hostname, where.port))
    try:
        with connect(
            asked.geturl(), sock=door, origin=origin, subprotocols=[PROTOCOL], close_timeout=0.1
        ) as client:
            assert client.recv(timeout=PATIENCE_S)
            return 101
    except InvalidStatus as error:
        assert b"serverInfo" not in error.response.body
        return error.response.status_code


PAGES = {
    403: [
        *("https://evil.example", "http://evil.example:8080", "http://localhost.evil.example"),
        *("http://127.0.0.1@evil.example", "null"),
        "http://lichtblick.example:8080",
    ],
    101: [
        *(None, "https://app.foxglove.dev", "http://localhost:8080", "http://127.0.0.1:9000"),
        "file://",
    ],
}


@pytest.mark.parametrize(("status", "pages"), PAGES.items())
def test_pages_of_other_sites_are_refused_even_with_the_token(status, pages):
    with Live() as server:
        assert [knock(server.url, origin=page) for page in pages] == [status] * len(pages)


def test_other_names_of_this_machine_and_other_tokens_are_refused(server):
    port, token = server.port, urlsplit(server.url).path
    for host in ("evil.example", "192.168.1.7", "127.0.0.1.evil.example"):
        assert knock(server.url, f"{host}:{port}") == 403
    assert knock(server.url, "localhost:1") == 403
    assert knock(server.url, f"localhost:{port}") == 101
    for path in ("", "/", "/" + "A" * 16, token[:-1], token + "A", token.upper() + "x"):
        assert knock(server.url, path=path) == 403


@pytest.mark.parametrize(
    "said",
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
def test_what_a_client_says_wrong_ends_its_connection_and_no_other(said, capfd):
    with Live() as server, Viewer(server.url) as other:
        with Viewer(server.url) as viewer, pytest.raises(ConnectionClosedError):
            viewer.socket.send(said)
            viewer.until(lambda got: False)
        server.viewers.messages([frame(1)])
        other.subscribe(FRAMES).until(lambda got: got[0] == FRAMES)
    assert capfd.readouterr().err == ""


def test_what_was_published_last_is_sent_before_the_end():
    server = Live()
    with Viewer(server.url) as viewer:
        server.viewers.messages([frame(0)])
        viewer.subscribe(FRAMES).until(lambda got: got[0] == FRAMES)
        server.viewers.messages([frame(number) for number in range(1, 500)])
        server.close()
        viewer.until(lambda got: got[:2] == (FRAMES, START_NS + 499))


def test_no_more_is_sent_of_what_a_viewer_gave_up(server):
    with Viewer(server.url) as viewer:
        server.viewers.messages([frame(1), Entry(TRANSFORMS, START_NS + 1, START_NS, b"")])
        viewer.subscribe(FRAMES).until(lambda got: got[0] == FRAMES)
        ended = [100 + viewer.channels[FRAMES]["id"]]
        viewer.socket.send(json.dumps({"op": "unsubscribe", "subscriptionIds": ended}))
        viewer.subscribe(TRANSFORMS).until(lambda got: got[0] == TRANSFORMS)
        server.viewers.messages([frame(2), Entry(TRANSFORMS, START_NS + 3, START_NS, b"")])
        viewer.until(lambda got: got[:2] == (TRANSFORMS, START_NS + 3))
        assert [got[1] - START_NS for got in viewer.all if got[0] == FRAMES] == [1]


def test_a_port_in_use_is_a_mistake_of_the_user(server):
    with pytest.raises(UsageError, match=f"port {server.port}: cannot be used"):
        LoopbackServer(server.viewers, server.port)


def test_each_server_has_its_own_token(server):
    assert server.url.startswith("ws://127.0.0.1:")
    with Live() as other:
        assert other.token != server.token
        assert len(other.token) >= 16


def answered(server, request):
    with socket.create_connection(("127.0.0.1", server.port), timeout=PATIENCE_S) as door:
        door.sendall(f"{request}\r\nConnection: close\r\n\r\n".encode())
        return door.makefile("rb").read()[:13]


ODD = (
    "GET * HTTP/1.1",
    "GET http://[ HTTP/1.1",
    "GET /%ff%00 HTTP/1.1",
    "GET / HTTP/1.1\r\nOrigin: http://[",
    "OPTIONS * HTTP/1.1",
    "POST / HTTP/1.1",
)


def test_nothing_else_is_served_and_a_strange_request_prints_nothing(server, capfd):
    """Regression: a traceback on the operator's terminal."""
    for line in (*ODD, f"GET /{server.token} HTTP/1.1", f"GET /{server.token}/x HTTP/1.1"):
        said = answered(server, f"{line}\r\nHost: 127.0.0.1:{server.port}")
        assert said in (b"", b"HTTP/1.1 400 ", b"HTTP/1.1 403 ", b"HTTP/1.1 426 "), line
    said = answered(server, "GET / HTTP/1.1\r\nUpgrade: websocket\r\nOrigin: http://[")
    assert said in (b"", b"HTTP/1.1 403 ")
    assert capfd.readouterr() == ("", "")

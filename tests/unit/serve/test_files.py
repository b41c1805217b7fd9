import http.client
import socket
import struct
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.serve.server import LoopbackServer, byte_range

DATA = bytes(range(256)) * 1000


@pytest.fixture
def server(tmp_path):
    (tmp_path / "trial-000.mcap").write_bytes(DATA)
    (tmp_path / "secret.txt").write_text("secret")
    logs = {"trial-000.mcap": tmp_path / "trial-000.mcap"}
    with LoopbackServer(page=b"<p>page", layout=b'{"layout": "a"}', logs=logs) as found:
        yield found


def ask(server, method="GET", path=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    path = path or server.log_url("trial-000.mcap").removeprefix(f"http://127.0.0.1:{server.port}")
    connection.request(method, path, headers=headers)
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer, body


def test_the_page_and_the_log_are_served(server):
    answer, body = ask(server, path=f"/{server.token}/")
    assert (answer.status, body) == (200, b"<p>page")
    answer, body = ask(server)
    assert (answer.status, body) == (200, DATA)
    assert answer.headers["Accept-Ranges"] == "bytes"
    assert answer.headers["Access-Control-Allow-Origin"] == "*"
    answer, body = ask(server, path=f"/{server.token}/layout.json")
    assert (answer.status, body) == (200, b'{"layout": "a"}')
    assert answer.headers["Content-Type"] == "application/json; charset=utf-8"
    assert answer.headers["Content-Disposition"] == 'attachment; filename="layout.json"'


@pytest.mark.parametrize(
    ("asked", "part"),
    [
        *(
            ("bytes=0-9", (0, 9)),
            ("bytes=255990-", (255990, 255999)),
            ("bytes=-5", (255995, 255999)),
        ),
        *((asked, None) for asked in ("bytes=256000-", "bytes=9-3", "lines=1-2", "bytes=1-2,4-5")),
    ],
)
def test_a_part_of_a_log_is_served_or_refused(server, asked, part):
    answer, body = ask(server, Range=asked)
    first, last = part or (0, -1)
    assert (answer.status, body) == (206 if part else 416, DATA[first : last + 1])
    span = f"{first}-{last}" if part else "*"
    assert answer.headers["Content-Range"] == f"bytes {span}/{len(DATA)}"


def test_a_viewer_of_another_origin_may_ask(server):
    answer, _ = ask(
        server, "OPTIONS", Origin="http://viewer", **{"Access-Control-Request-Method": "GET"}
    )
    assert answer.status == 204
    assert answer.headers["Access-Control-Allow-Headers"] == "Range"
    answer, body = ask(server, "HEAD")
    assert (answer.status, body) == (200, b"")
    assert answer.headers["Content-Length"] == str(len(DATA))


def test_nothing_else_is_served(server):
    token = server.token
    logs = (f"/{token}/logs/{name}" for name in ("secret.txt", "..%2Fsecret.txt", "../secret.txt"))
    for path in (
        *("/", "/x/", "/%ff%00", f"/{token}", "/x/logs/trial-000.mcap", *logs),
        f"/{token}/logs/trial-000.mcap/",
    ):
        assert ask(server, path=path)[0].status == 404, path
    assert ask(server, path=f"/{token}/", Host="evil.example")[0].status == 404
    assert ask(server, "POST", path=f"/{token}/")[0].status == 501


def test_only_this_machine_can_reach_it_and_each_server_has_its_own_token(server, tmp_path):
    assert server.page_url.startswith("http://127.0.0.1:")
    with LoopbackServer() as other:
        assert other.token != server.token
        assert len(other.token) >= 16


def test_a_log_that_vanished_is_not_found(server, tmp_path):
    Path(tmp_path / "trial-000.mcap").unlink()
    assert ask(server)[0].status == 404


@given(st.text(max_size=30), st.integers(0, 10**6))
def test_any_header_gives_a_range_inside_the_file_or_none(text, size):
    for asked in (text, f"bytes={text}"):
        found = byte_range(asked, size)
        assert found is None or 0 <= found[0] <= found[1] < size


ODD = (
    "GET * HTTP/1.1",
    "GET http://[ HTTP/1.1",
    "OPTIONS * HTTP/1.1",
    "HEAD * HTTP/1.1",
    "GET / HTTP/1.1\r\nOrigin: http://[",
)


@pytest.mark.parametrize("line", ODD)
def test_a_strange_request_prints_nothing(server, line, capfd):
    """Regression: a traceback on the operator's terminal."""
    with socket.create_connection(("127.0.0.1", server.port), timeout=10) as door:
        door.sendall(f"{line}\r\nHost: x\r\nConnection: close\r\n\r\n".encode())
        assert door.makefile("rb").read()[:13] in (b"", b"HTTP/1.1 404 ")
    assert capfd.readouterr() == ("", "")


def test_a_viewer_that_leaves_prints_nothing(server, capfd):
    """Regression: a traceback, too."""
    path = server.log_url("trial-000.mcap").partition(str(server.port))[2]
    server.logs["trial-000.mcap"].write_bytes(bytes(30_000_000))
    door = socket.create_connection(("127.0.0.1", server.port), timeout=10)
    door.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    door.sendall(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n\r\n".encode())
    assert door.recv(12) == b"HTTP/1.1 200"
    door.close()
    server.close()
    for thread in threading.enumerate():
        if "process_request" in thread.name:
            thread.join(10)
    assert capfd.readouterr() == ("", "")

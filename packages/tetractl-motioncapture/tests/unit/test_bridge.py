"""Tests of what the library's process prints, with a fake of the library."""

import io
import json
import sys
import types

import pytest
from tetractl_motioncapture import bridge


class Body:
    def __init__(self, position, x, y, z, w):
        self.position = position
        self.rotation = types.SimpleNamespace(x=x, y=y, z=z, w=w)


def capture_of(frames):
    """A connection of the library: each frame has the next of these bodies."""
    bodies = iter(frames)
    made = types.SimpleNamespace()

    def wait_for_next_frame():
        try:
            made.rigidBodies = next(bodies)
        except StopIteration:
            raise BrokenPipeError from None

    made.waitForNextFrame = wait_for_next_frame
    return made


def printed(frames, system="vicon", options=None):
    """The bodies of each printed line, and what the library was given."""
    out = io.StringIO()
    given = []

    def connect(*arguments):
        given.append(arguments)
        return capture_of(frames)

    name = json.dumps([system, "10.0.0.5", options or {}])
    bridge.stream(connect, name, out)
    lines = [line.split(" ", 1) for line in out.getvalue().splitlines()]
    assert all(int(stamp) > 0 for stamp, _ in lines)
    return [json.loads(text)["bodies"] for _, text in lines], given


ONE = {"G": Body([1.5, 2.5, -3.0], 0.1, 0.2, 0.3, 0.9)}


def test_a_line_has_position_and_quaternion_in_this_order():
    bodies, given = printed([ONE], options={"port": "3883"})
    assert bodies == [{"G": [1.5, 2.5, -3.0, 0.1, 0.2, 0.3, 0.9]}]
    assert given == [("vicon", {"hostname": "10.0.0.5", "port": "3883"})]


def test_every_body_of_every_frame_is_printed():
    two = ONE | {"B": Body([0, 0, 0], 0, 0, 0, 1)}
    bodies, _ = printed([ONE, two, ONE])
    assert [sorted(body) for body in bodies] == [["G"], ["B", "G"], ["G"]]


@pytest.mark.parametrize(("system", "lines"), [("vrpn", 2), ("vicon", 4), ("qualisys", 4)])
def test_a_frame_without_bodies_is_news_unless_the_system_sends_one_by_turns(system, lines):
    bodies, _ = printed([ONE, {}, ONE, {}], system)
    assert len(bodies) == lines


def test_positions_of_any_type_of_number_are_printed_as_numbers():
    class Number:
        def __float__(self):
            return 0.25

    bodies, _ = printed([{"G": Body([Number()] * 3, 0, 0, 0, 1)}])
    assert bodies[0]["G"][:3] == [0.25] * 3


def test_a_failed_connection_is_the_last_line_of_the_process(monkeypatch):
    def connect(*_):
        raise RuntimeError("no such host")

    library = types.SimpleNamespace(connect=connect)
    monkeypatch.setitem(sys.modules, "motioncapture", library)
    monkeypatch.setattr(bridge.os, "dup", lambda fd: fd)
    monkeypatch.setattr(bridge.os, "dup2", lambda *_: None)
    monkeypatch.setattr(bridge.os, "fdopen", lambda *_: io.StringIO())
    monkeypatch.setattr(bridge.ctypes, "CDLL", lambda *_: types.SimpleNamespace())
    monkeypatch.setattr(sys, "argv", ["bridge", '["vicon", "10.0.0.5", {}]'])
    with pytest.raises(SystemExit) as caught:
        bridge.main()
    assert caught.value.code == "motion capture: no such host"

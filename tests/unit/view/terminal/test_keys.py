"""Tests of decoding keys from bytes, and of the keys that stop the robots."""

import os
import sys
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.view.terminal.keys import StopKey, decode_keys

pytestmark = pytest.mark.slow
PATIENCE_S = 60


@pytest.mark.parametrize(
    ("data", "keys"),
    [
        (b" q", ["space", "q"]),
        (b"\x1b[C\x1b[D", ["right", "left"]),
        (b"\x1bOC\x1bOD", ["right", "left"]),
        (b"\x1b[A.\x1b[5~+", ["up", ".", "+"]),
        (b"\x1b[B\x1bOB\x1bOA", ["down", "down", "up"]),
        (b"\x1b[<0;12;5M\x1b[<32;14;5M\x1b[<0;14;5m", ["<0;12;5M", "<32;14;5M", "<0;14;5m"]),
        (b"\x1b\x1b[C", ["right"]),
        (b"\x1b[1;5C-", ["-"]),
        (b"\x1b[H\x1bOH\x1b[1~\x1b[7~", ["home"] * 4),
        (b"\x1b[F\x1bOF\x1b[4~\x1b[8~", ["end"] * 4),
        (b",eE?np", [",", "e", "E", "?", "n", "p"]),
        (b"=_Q", ["+", "-", "q"]),
        (b"\xc3\xa9\x00\t", []),
    ],
)
def test_keys_have_names(data, keys):
    assert decode_keys(data) == (keys, b"")


@given(st.binary(max_size=30))
def test_anything_decodes_and_only_a_beginning_is_kept(data):
    keys, rest = decode_keys(data)
    assert not rest or rest[0] == 0x1B
    assert decode_keys(data.replace(b"\x1b", b""))[1] == b""
    assert all(key.isprintable() for key in keys)


KEYS = st.sampled_from([b"\x1b[C", b"\x1bOD", b" ", b".", b"\x1b[5~"])


@given(st.lists(KEYS), st.data())
def test_a_sequence_torn_between_two_reads_is_put_together(parts, data):
    sequence = b"".join(parts)
    cut = data.draw(st.integers(0, len(sequence)))
    first, torn = decode_keys(sequence[:cut])
    second, rest = decode_keys(torn + sequence[cut:])
    assert (first + second, rest) == decode_keys(sequence)


@pytest.fixture
def terminal(monkeypatch):
    """The operator's end of a terminal, whose other end is stdin."""
    ours, theirs = os.openpty()
    with os.fdopen(theirs) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield ours
    os.close(ours)


def pressed(terminal, *pieces):
    """Return how often the robots were stopped once all keys, and then Enter, were read."""
    stops = []
    entered = threading.Event()
    with StopKey(lambda: stops.append(1), entered.set):
        for piece in (*pieces, b"\n"):
            os.write(terminal, piece)
        assert entered.wait(PATIENCE_S)
    return len(stops)


@pytest.mark.parametrize("keys", [b" ", b"\x1b\x1b", b"\x1bx", b"\x1b[A ", b"\x1b[A\x1b\x1b"])
def test_space_and_escape_stop_the_robots(keys, terminal):
    assert pressed(terminal, keys) >= 1  # once a read: a terminal may hand the keys on in pieces


@pytest.mark.parametrize("key", [b"\x1b[A", b"\x1bOB", b"\x1b[1;5C", b"\x1b[5~", b"\x1b\x1b[D"])
def test_an_arrow_is_no_emergency_stop(key, terminal):
    """Regression: its first byte is that of Esc, and robots were stopped until switched off."""
    assert pressed(terminal, key) == 0

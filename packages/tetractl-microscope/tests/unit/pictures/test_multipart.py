"""Tests of the multipart parser with valid, cut and damaged streams. They need no OpenCV."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tetractl_microscope.pictures.multipart import BODY_MAX, HEAD_MAX, Multipart

pytestmark = pytest.mark.slow

MARK = "frame-4711"
BODIES = st.lists(st.binary(max_size=300).filter(lambda body: b"--" not in body), max_size=6)


def part(body, length=True, mark=MARK):
    head = f"--{mark}\r\nContent-Type: image/jpeg\r\n"
    if length:
        head += f"content-length: {len(body)}\r\n"
    return head.encode() + b"\r\n" + body + b"\r\n"


def fed(parser, stream, sizes=(7, 1, 64)):
    """Feed a stream in pieces of these sizes, over and over."""
    bodies = []
    start = 0
    turn = 0
    while start < len(stream):
        size = max(1, sizes[turn % len(sizes)])
        bodies += parser.feed(stream[start : start + size])
        start += size
        turn += 1
    return bodies


SIZES = st.lists(st.integers(1, 200), min_size=1, max_size=5)


@given(BODIES, st.booleans(), SIZES)
def test_parts_come_out_however_the_stream_is_cut(bodies, length, sizes):
    parser = Multipart(MARK)
    stream = b"preamble\r\n" + b"".join(part(body, length) for body in bodies)
    stream += f"--{MARK}".encode()
    assert fed(parser, stream, sizes) == bodies
    assert parser.damaged == 0


@given(
    st.binary(max_size=200).filter(lambda body: b"--" not in body),
    st.binary(max_size=200),
    st.integers(0, 10_000),
    st.integers(0, 300),
)
def test_whatever_is_damaged_later_parts_come_out(body, garbage, place, dropped):
    """A random place of the stream is overwritten; the parser gets over it."""
    parser = Multipart(MARK)
    good = part(b"first") + part(body) + part(b"third")
    place %= len(good)
    spoiled = good[:place] + garbage + good[place + dropped :]
    fed(parser, spoiled)
    assert len(parser.feed(b"")) == 0
    later = part(b"x" * 20) + part(b"last but one") + part(b"last")
    bodies = fed(parser, later)
    assert bodies[-1:] == [b"last"]


@given(st.lists(st.binary(max_size=2000), max_size=20))
def test_anything_may_come_and_little_is_held(pieces):
    parser = Multipart("m")
    for piece in pieces:
        for body in parser.feed(piece):
            assert len(body) <= sum(map(len, pieces))


def test_a_length_that_is_no_number_or_too_long_is_refused():
    for length in (b"12a", b"-5", b"99999999999999", str(BODY_MAX + 1).encode()):
        parser = Multipart(MARK)
        bad = b"--" + MARK.encode() + b"\r\nContent-Length: " + length + b"\r\n\r\nbody\r\n"
        assert fed(parser, bad + part(b"good")) == [b"good"]
        assert parser.damaged == 1


def test_endless_heads_and_bodies_are_dropped():
    parser = Multipart(MARK)
    start = f"--{MARK}\r\n".encode()
    assert parser.feed(start + b"x" * (HEAD_MAX + 1)) == []
    assert parser.damaged == 1
    assert parser.feed(start + b"Content-Type: image/jpeg\r\n\r\n" + b"y" * BODY_MAX) == []
    assert parser.feed(b"y" * 100) == []
    assert parser.damaged == 2
    assert parser.feed(part(b"good")) == [b"good"]

"""Checks for every pair of functions that encode and decode a frame of bytes."""

import pytest
from hypothesis import strategies as st

from tetractl.core.errors import WireError
from tetractl.lab import cobs

ANY_BYTES = st.binary(max_size=100) | st.binary(min_size=1, max_size=78).map(
    lambda body: cobs.encode_with_crc(body)[:-1]
)


def check_round_trip(encode, decode, message):
    """A message comes out as it went in, and every error of one bit is detected."""
    frame = encode(message)
    assert frame.index(0) == len(frame) - 1
    assert decode(frame[:-1]) == message
    for bit in range(8 * (len(frame) - 1)):
        bad = bytearray(frame[:-1])
        bad[bit // 8] ^= 1 << bit % 8
        with pytest.raises(WireError):
            decode(bytes(bad))


def check_any_bytes(encode, decode, raw):
    """Any bytes are a message, or refused."""
    try:
        read = decode(raw)
    except WireError:
        return
    assert decode(encode(read)[:-1]) == read

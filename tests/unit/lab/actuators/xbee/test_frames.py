import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.errors import WireError
from tetractl.lab.actuators.xbee.frames import (
    CONTENT_MAX,
    FRAME_TYPES,
    AtCommand,
    AtResponse,
    Decoder,
    Other,
    Receive,
    Receive16,
    Receive64,
    Transmit16,
    TransmitStatus,
    encode,
    parse_content,
)

FAR = 0x0013A20012345678
VECTORS = [
    (Transmit16(0x87, 0x1234, 0, b"TxData"), False, "7E 00 0B 01 87 12 34 00 54 78 44 61 74 61 EB"),
    (
        Transmit16(0, 0xFFFF, 0, b"Broadcast"),
        False,
        "7E 00 0E 01 00 FF FF 00 42 72 6F 61 64 63 61 73 74 6D",
    ),
    (Receive16(0x1234, 0x5E, 1, b"TxData"), False, "7E 00 0B 81 12 34 5E 01 54 78 44 61 74 61 93"),
    (
        Receive64(FAR, 0x5E, 1, b"TxData"),
        False,
        "7E 00 11 80 00 13 A2 00 12 34 56 78 5E 01 54 78 44 61 74 61 11",
    ),
    (
        Other(0x10, bytes.fromhex("010013A200400A0127FFFE0000") + b"TxData0A"),
        True,
        "7E 00 16 10 01 00 7D 33 A2 00 40 0A 01 27 FF FE 00 00 54 78 44 61 74 61 30 41 7D 33",
    ),
    (AtCommand(1, b"BD", b"\x08"), False, "7E 00 05 08 01 42 44 08 68"),
    (TransmitStatus(1, 0), False, "7E 00 03 89 01 00 75"),
    (Other(0x23, b"\x11"), False, "7E 00 02 23 11 CB"),
    (Other(0x23, b"\x11"), True, "7E 00 02 23 7D 31 CB"),
]

u8, u16, u64 = (st.integers(0, 2**bits - 1) for bits in (8, 16, 64))
data = st.binary(max_size=100) | st.lists(
    st.sampled_from([0x7E, 0x7D, 0x11, 0x13, 0x5E, 0x00]), max_size=40
).map(bytes)
letters = st.binary(min_size=2, max_size=2)
frames = st.one_of(
    st.builds(Transmit16, u8, u16, u8, data),
    st.builds(AtCommand, u8, letters, data),
    st.builds(Receive64, u64, u8, u8, data),
    st.builds(Receive16, u16, u8, u8, data),
    st.builds(AtResponse, u8, letters, u8, data),
    st.builds(TransmitStatus, u8, u8),
    st.builds(Receive, u64, u16, u8, data),
    st.builds(Other, st.sampled_from([0x02, 0x23, 0x8A, 0x7E]), data),
)
quiet = st.binary(max_size=30).map(lambda raw: raw.replace(b"\x7e", b""))  # starts no frame
modes = pytest.mark.parametrize("escaped", [False, True], ids=["AP=1", "AP=2"])


@pytest.mark.parametrize(("frame", "escaped", "text"), VECTORS)
def test_documented_vectors(frame, escaped, text):
    raw = bytes.fromhex(text)
    assert encode(frame, escaped) == raw
    assert Decoder(escaped).feed(raw) == [frame]


def fed_in_pieces(decoder, stream, cuts):
    found = []
    edges = sorted({0, len(stream), *(cut % (len(stream) + 1) for cut in cuts)})
    for start, stop in itertools.pairwise(edges):
        found += decoder.feed(stream[start:stop])
    return found


@modes
@given(st.lists(st.tuples(quiet, frames), max_size=5), st.lists(st.integers(0, 1000), max_size=9))
def test_garbage_between_frames_is_dropped_and_counted(escaped, parts, cuts):
    decoder = Decoder(escaped)
    stream = b"".join(garbage + encode(frame, escaped) for garbage, frame in parts)
    assert fed_in_pieces(decoder, stream, cuts) == [frame for _, frame in parts]
    assert decoder.dropped_bytes == sum(len(garbage) for garbage, _ in parts)


@given(st.lists(st.tuples(st.binary(max_size=60), frames), max_size=4))
def test_escaped_frames_are_found_behind_any_garbage(parts):
    found = Decoder().feed(b"".join(garbage + encode(frame) for garbage, frame in parts))
    rest = iter(found)  # garbage may happen to be a frame as well
    assert all(frame in rest for _, frame in parts)


@given(st.binary(max_size=300), frames)
def test_plain_frames_are_found_again_once_the_garbage_has_passed(garbage, frame):
    decoder = Decoder(escaped=False)
    decoder.feed(garbage + bytes(CONTENT_MAX + 4))
    assert decoder.feed(encode(frame, escaped=False)) == [frame]


@modes
@given(frame=frames, at=st.integers(1, 1000), bit=st.integers(0, 7))
def test_a_flipped_bit_never_gives_a_wrong_frame(escaped, frame, at, bit):
    raw = bytearray(encode(frame, escaped))
    at = max(3, at % len(raw))  # content or checksum: a length may cut a shorter frame out
    raw[at] ^= 1 << bit
    decoder = Decoder(escaped)
    assert frame not in decoder.feed(bytes(raw))


@pytest.mark.parametrize("torn", ["7E", "7E 00", "7E 00 03", "7E 00 03 89 7D", "7E 00 7D", "7D"])
@modes
def test_a_frame_behind_a_torn_one_is_found(escaped, torn):
    decoder = Decoder(escaped)
    good = TransmitStatus(1, 0)
    raw = encode(good, escaped)
    found = decoder.feed(bytes.fromhex(torn) + raw)
    if not escaped:  # its length may make it wait
        found += decoder.feed(bytes(CONTENT_MAX))
    assert found == [good]
    assert decoder.dropped_bytes >= len(bytes.fromhex(torn))


def test_counters():
    good = encode(TransmitStatus(1, 0), escaped=False)
    decoder = Decoder(escaped=False)
    assert decoder.feed(good[:-1] + b"\x76" + good) == [TransmitStatus(1, 0)]
    assert (decoder.bad_checksums, decoder.dropped_bytes) == (1, len(good))
    short = encode(Other(0x81, b"\x12"), escaped=False)
    assert decoder.feed(short) == []
    assert decoder.malformed == 1


@pytest.mark.parametrize("api", sorted(FRAME_TYPES))
def test_short_contents_are_refused(api):
    kind = FRAME_TYPES[api]
    for size in range(kind.LAYOUT.size):
        with pytest.raises(WireError):
            parse_content(bytes([api]) + bytes(size))
    if not kind.HAS_DATA:
        with pytest.raises(WireError):
            parse_content(bytes([api]) + bytes(kind.LAYOUT.size + 1))


def test_frames_longer_than_the_radio_takes_are_not_encoded():
    with pytest.raises(WireError):
        encode(Transmit16(0, 0, 0, bytes(CONTENT_MAX)))
    with pytest.raises(WireError):
        parse_content(b"")

"""The current driver's C core; how it moves and stops is tested in C, in `firmware/tests`."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.device_replies import packed_reply

from tetractl.emulate import firmware
from tetractl.emulate.firmware import CoreEvent, DriverCore, DriverLimits
from tetractl.lab import cobs
from tetractl.lab.actuators.field.driver import (
    VERSION,
    DriverStatus,
    FieldCommand,
    FieldReply,
    decode_reply,
    encode_command,
)
from tetractl.lab.cobs import Flag

pytestmark = pytest.mark.skipif(firmware.compiler() is None, reason="no C compiler found")
LIMITS = DriverLimits(2000, 100_000)
FAST_MS = 100  # in which every current is reached


def sent(core, sequence, flags=Flag.RUN, x_ma=0, y_ma=0, at=0):
    (event,) = core.push(encode_command(FieldCommand(sequence, flags, x_ma, y_ma)), at)
    return event


@pytest.mark.parametrize(
    ("sequence", "new"), [(10, False), (9, False), (139, False), (137, True), (11, True)]
)
def test_a_frame_is_new_if_it_is_up_to_127_ahead_of_the_last(sequence, new):
    core = DriverCore(LIMITS)
    assert sent(core, 10, x_ma=100) is CoreEvent.ACCEPTED
    event = sent(core, sequence, x_ma=-300, y_ma=50, at=FAST_MS)
    assert event is (CoreEvent.ACCEPTED if new else CoreEvent.STALE)
    wished = (-300_000, 50_000) if new else (100_000, 0)
    assert core.currents_ua(2 * FAST_MS) == wished
    assert core.status(251) == (DriverStatus.RUNNING if new else DriverStatus.SILENT)
    assert sent(core, sequence, at=1000) is CoreEvent.ACCEPTED  # after a silence any is new


def test_an_old_frame_stops_all_the_same_and_a_poll_in_it_is_answered():
    core = DriverCore(LIMITS)
    sent(core, 10, x_ma=100)
    assert sent(core, 10, Flag.RUN | Flag.POLL) is CoreEvent.STALE
    assert core.take_reply(0) == b""
    assert core.currents_ua(FAST_MS) == (100_000, 0)
    assert sent(core, 8, Flag.POLL, at=FAST_MS) is CoreEvent.STALE
    assert core.currents_ua(2 * FAST_MS) == (0, 0)
    assert decode_reply(core.take_reply(2 * FAST_MS)[:-1]).sequence == 8
    sent(core, 11, Flag.EMERGENCY_STOP)
    assert sent(core, 12, x_ma=100) is CoreEvent.ACCEPTED
    assert core.status(0) == DriverStatus.EMERGENCY_STOPPED


def test_a_reply_tells_what_was_measured_counted_and_built_in():
    core = DriverCore(LIMITS)
    core.measured(-7, 8, 11_900, -32_768)
    sent(core, 1, Flag.RUN | Flag.POLL, x_ma=3000)
    status = DriverStatus.RUNNING | DriverStatus.LIMITED
    reply = FieldReply(1, status, VERSION, -7, 8, 11_900, -32_768, 3, 2, 2000, 100_000, 250)
    other = packed_reply(reply)
    assert core.push(other, 0) == [CoreEvent.FOREIGN]
    bad = bytearray(encode_command(FieldCommand(2, Flag.RUN)))
    bad[1] ^= 1  # not of a driver, were its CRC right
    unknown = cobs.frame_with_crc(bytes([0x53, 2, 8, 0, 0, 0, 0]))
    assert core.push(bytes(bad) + unknown, 0) == [CoreEvent.REJECTED] * 2
    sent(core, 2, x_ma=3000)
    sent(core, 2)
    assert core.currents_ua(FAST_MS) == (2_000_000, 0)
    assert core.take_reply(FAST_MS) == other
    assert core.take_reply(FAST_MS) == b""


ma = st.integers(-32_768, 32_767)
u8 = st.integers(0, 255)
limits = st.builds(DriverLimits, st.integers(1, 32_767), st.integers(1, 2**32 - 1))
near = st.integers(0, 5)  # sequences that often repeat or go back
commands = st.builds(FieldCommand, near | u8, st.integers(0, 7).map(Flag), ma, ma).map(
    encode_command
)
replies = st.builds(FieldReply, u8, st.integers(0, 31).map(DriverStatus), *([st.just(0)] * 10))
foreign = (
    replies.map(packed_reply)
    | st.binary(min_size=1, max_size=78).map(cobs.frame_with_crc)
    | st.tuples(u8, u8).map(lambda pair: cobs.frame_with_crc(bytes([0x53, *pair, 1, 2, 3, 4])))
)


@st.composite
def damaged(draw):
    frame = bytearray(draw(commands))
    frame[draw(st.integers(0, len(frame) - 1))] ^= draw(st.integers(1, 255))
    return bytes(frame)


lines = commands | commands | damaged() | foreign | st.binary(max_size=120)
pauses = st.integers(0, 30) | st.sampled_from([249, 250, 251, 2**31, 2**32 - 1])
acts = st.tuples(pauses, lines)


@given(limits, st.lists(acts, max_size=30))
def test_no_bytes_break_the_limits(limits, acts):
    core, before, now = DriverCore(limits), (0, 0), 0
    for pause, data in acts:
        now += min(pause, 300)
        core.push(data, now)
        after = core.currents_ua(now)
        assert max(map(abs, after)) <= 1000 * limits.current_max_ma
        moved = max(abs(a - b) for a, b in zip(after, before, strict=True))
        assert moved <= min(pause, 300) * limits.slew_ma_s
        before = after

"""The current driver's C core: against its Python twin, and in what it promises."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.field_twin import Twin

from tetractl.emulate import firmware
from tetractl.emulate.firmware import DriverCore, DriverLimits
from tetractl.lab import cobs
from tetractl.lab.actuators.field.driver import (
    DriverStatus,
    FieldCommand,
    FieldFlag,
    FieldReply,
    encode_command,
    encode_reply,
)

pytestmark = pytest.mark.skipif(firmware.compiler() is None, reason="no C compiler found")


ma = st.integers(-32_768, 32_767)
u8 = st.integers(0, 255)
limits = st.builds(
    DriverLimits, st.integers(1, 32_767), st.integers(1, 2**32 - 1), st.integers(1, 400), ma
)
near = st.integers(0, 5)  # sequences that often repeat or go back
commands = st.builds(FieldCommand, near | u8, st.integers(0, 7).map(FieldFlag), ma, ma).map(
    encode_command
)
replies = st.builds(FieldReply, u8, st.integers(0, 31).map(DriverStatus), *([st.just(0)] * 10))
foreign = (
    replies.map(encode_reply)
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
readings = st.tuples(ma, ma, st.integers(0, 65_535), st.just(-32_768) | ma)
acts = st.tuples(pauses, lines, st.none() | st.none() | readings)


@given(limits, st.integers(0, 2**32 - 1), st.lists(acts, max_size=30))
@settings(max_examples=300)
def test_core_and_twin_agree_on_everything(limits, start, acts):
    core, twin = DriverCore(limits, start), Twin(limits, start)
    now = start
    for pause, data, measured in acts:
        now = (now + pause) % 2**32
        if measured is not None:
            core.measured(*measured)
            twin.measured(*measured)
        assert core.push(data, now) == twin.push(data, now)
        assert core.currents_ua(now) == twin.currents_ua(now)
        assert core.status(now) == twin.status(now)
        assert core.take_reply(now) == twin.take_reply(now)


@given(limits, st.lists(acts, max_size=30))
def test_no_bytes_break_the_limits(limits, acts):
    core, before, now = DriverCore(limits), (0, 0), 0
    for pause, data, _ in acts:
        now += min(pause, 300)
        core.push(data, now)
        after = core.currents_ua(now)
        assert max(map(abs, after)) <= 1000 * limits.current_max_ma
        moved = max(abs(a - b) for a, b in zip(after, before, strict=True))
        assert moved <= min(pause, 300) * limits.slew_ma_s
        before = after

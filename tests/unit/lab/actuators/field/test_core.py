"""The current driver's C core: against its Python twin, and in what it promises."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.field_twin import Twin

from tetractl.emulate import firmware
from tetractl.emulate.firmware import CoreEvent, DriverCore, DriverLimits
from tetractl.lab import cobs
from tetractl.lab.actuators.field.driver_protocol import (
    DriverStatus,
    FieldCommand,
    FieldFlag,
    FieldReply,
    decode_reply,
    encode_command,
    encode_reply,
)

pytestmark = pytest.mark.skipif(firmware.compiler() is None, reason="no C compiler found")

LIMITS = DriverLimits(current_max_ma=1000, slew_ma_s=10_000)  # 10 mA a millisecond

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


def run(sequence, x_ma, y_ma, flags=FieldFlag.RUN):
    return encode_command(FieldCommand(sequence, flags, x_ma, y_ma))


def test_currents_move_in_a_straight_line():
    core = DriverCore(LIMITS)
    core.push(run(1, 400, -200), 0)
    assert [core.currents_ua(now) for now in (0, 10, 20, 40, 90)] == [
        (0, 0),
        (100_000, -50_000),
        (200_000, -100_000),
        (400_000, -200_000),
        (400_000, -200_000),
    ]


def test_too_much_current_keeps_the_direction():
    core = DriverCore(LIMITS)
    core.push(run(1, -2000, 1000), 0)
    assert core.currents_ua(200) == (-1_000_000, 500_000)
    assert core.status(200) == DriverStatus.RUNNING | DriverStatus.LIMITED
    core.push(run(2, 5, 5), 201)
    assert core.status(201) == DriverStatus.RUNNING


def test_the_watchdog_ramps_the_field_down_after_its_time_and_not_before():
    core = DriverCore(LIMITS)
    core.push(run(1, 100, 50), 0)
    assert core.currents_ua(249) == (100_000, 50_000)
    assert core.currents_ua(250) == (100_000, 50_000)
    assert core.status(250) == DriverStatus.SILENT
    assert core.currents_ua(255) == (50_000, 25_000)
    assert core.currents_ua(260) == (0, 0)
    assert core.push(run(1, 100, 50), 300) == [CoreEvent.ACCEPTED]  # a restarted controller


def test_repeated_and_damaged_frames_do_not_feed_the_watchdog():
    core = DriverCore(LIMITS)
    core.push(run(5, 100, 50), 0)
    bad = bytearray(run(6, 100, 50))
    bad[4] ^= 2
    for now in range(1, 250):
        assert core.push(bytes(bad), now) == [CoreEvent.REJECTED]
        assert core.push(run(5, 900, 900), now) == [CoreEvent.STALE]
    assert core.currents_ua(249) == (100_000, 50_000)
    assert core.status(250) == DriverStatus.SILENT


def test_a_stop_is_obeyed_even_when_old():
    core = DriverCore(LIMITS)
    core.push(run(9, 100, 50), 0)
    core.currents_ua(20)
    assert core.push(run(8, 100, 50, FieldFlag(0)), 20) == [CoreEvent.STALE]
    assert core.currents_ua(25) == (50_000, 25_000)
    assert core.currents_ua(30) == (0, 0)


def test_an_emergency_stop_holds_until_power_is_cycled():
    core = DriverCore(LIMITS)
    core.push(run(1, 100, 50), 0)
    core.push(run(2, 100, 50, FieldFlag.RUN | FieldFlag.EMERGENCY_STOP), 20)
    for now in range(40, 2000, 20):
        core.push(run(now // 20 % 256, 100, 50), now)
        assert core.currents_ua(now) == (0, 0)
    assert DriverStatus.EMERGENCY_STOPPED in core.status(2000)
    core = DriverCore(LIMITS)
    core.push(run(1, 100, 50), 0)
    assert core.currents_ua(20) == (100_000, 50_000)


def test_heat_stops_for_good():
    core = DriverCore(LIMITS)
    core.push(run(1, 100, 50), 0)
    core.measured(100, 50, 12_000, 799)
    assert core.currents_ua(20) == (100_000, 50_000)
    core.measured(100, 50, 12_000, 800)
    core.measured(100, 50, 12_000, 200)
    core.push(run(2, 100, 50), 40)
    assert core.currents_ua(60) == (0, 0)
    assert core.status(60) == DriverStatus.HOT | DriverStatus.EMERGENCY_STOPPED


def test_a_polled_driver_replies_once():
    core = DriverCore(LIMITS)
    core.push(b"\x05rubbish\0", 0)
    core.measured(-3, 4, 12_040, 253)
    core.push(run(7, 1, 1, FieldFlag.RUN | FieldFlag.POLL), 0)
    assert decode_reply(core.take_reply(0)[:-1]) == FieldReply(
        7, DriverStatus.RUNNING, 1, -3, 4, 12_040, 253, 1, 1, 1000, 10_000, 250
    )
    assert core.take_reply(0) == b""

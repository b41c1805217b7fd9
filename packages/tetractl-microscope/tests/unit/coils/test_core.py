"""Tests of the current driver's C firmware against its Python reference implementation."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from testkit.device_replies import packed_reply
from tetractl_emulator import firmware
from tetractl_emulator.firmware import CoreEvent
from tetractl_emulator.pictures.driver_core import DriverCore, DriverLimits
from tetractl_microscope.coils.driver import (
    VERSION,
    DriverStatus,
    FieldCommand,
    FieldReply,
    decode_command,
    encode_command,
)

from tetractl.core.errors import WireError
from tetractl.lab import cobs
from tetractl.lab.cobs import Flag

pytestmark = pytest.mark.skipif(firmware.compiler() is None, reason="no C compiler found")


def towards_zero(numerator, denominator):
    """Divide as C does."""
    quotient = abs(numerator) // denominator
    return quotient if numerator >= 0 else -quotient


class Twin:
    """The core once more, in Python, from docs/reference/wires.md."""

    def __init__(self, limits, now_ms=0):
        self.limits = limits
        self.wished = (0, 0)  # uA
        self.current = (0, 0)  # uA
        self.moved = self.heard = now_ms
        self.sequence = self.received = self.rejected = 0
        self.running = self.latched = self.limited = self.hot = False
        self.silent = True
        self.readings = (0, 0, 0, -32768)
        self.reply = None
        self.buffer = b""

    def push(self, data, now_ms):
        events = []
        for byte in data:
            self.watch(now_ms)
            if byte:
                self.buffer += bytes([byte])
            elif self.buffer:
                events.append(self.judge(self.buffer, now_ms))
                self.buffer = b""
        return events

    def judge(self, frame, now_ms):
        try:
            if cobs.decode_with_crc(frame)[0] != 0x53:
                return CoreEvent.FOREIGN
            command = decode_command(frame)
        except WireError:
            self.rejected = (self.rejected + 1) % 65_536
            return CoreEvent.REJECTED
        self.received = (self.received + 1) % 65_536
        is_new = self.silent or 1 <= (command.sequence - self.sequence) % 256 <= 127
        runs = Flag.RUN in command.flags
        self.latched |= Flag.EMERGENCY_STOP in command.flags
        if not runs or self.latched:
            self.stop()
        elif is_new:
            peak = max(abs(command.x_ma), abs(command.y_ma))
            limit = self.limits.current_max_ma
            self.limited = peak > limit
            wished = (command.x_ma, command.y_ma)
            if self.limited:
                wished = tuple(towards_zero(part * limit, peak) for part in wished)
            self.wished = tuple(1000 * part for part in wished)
            self.running = True
        if is_new:
            self.sequence = command.sequence
            self.heard = now_ms
            self.silent = False
        if Flag.POLL in command.flags and (is_new or not runs):
            self.reply = command.sequence
        return CoreEvent.ACCEPTED if is_new else CoreEvent.STALE

    def stop(self):
        self.wished = (0, 0)
        self.running = self.limited = False

    def watch(self, now_ms):
        room = (now_ms - self.moved) % 2**32 * self.limits.slew_ma_s
        gaps = [wish - now for wish, now in zip(self.wished, self.current, strict=True)]
        peak = max(map(abs, gaps))
        if peak > room:
            gaps = [towards_zero(gap * room, peak) for gap in gaps]
        self.current = tuple(now + gap for now, gap in zip(self.current, gaps, strict=True))
        self.moved = now_ms
        self.silent |= (now_ms - self.heard) % 2**32 >= self.limits.watchdog_ms
        if self.silent or self.latched:
            self.stop()

    def currents_ua(self, now_ms):
        self.watch(now_ms)
        return self.current

    def measured(self, x_ma, y_ma, supply_mv, temperature_dc):
        self.readings = (x_ma, y_ma, supply_mv, temperature_dc)
        self.hot |= temperature_dc >= self.limits.temperature_max_dc
        self.latched |= self.hot

    def status(self, now_ms):
        self.watch(now_ms)
        bits = self.running, self.latched, self.silent, self.limited, self.hot
        return DriverStatus(sum(bit << place for place, bit in enumerate(bits)))

    def take_reply(self, now_ms):
        if self.reply is None:
            return b""
        sequence = self.reply
        self.reply = None
        limits = self.limits.current_max_ma, self.limits.slew_ma_s, self.limits.watchdog_ms
        counts = self.received, self.rejected
        status = self.status(now_ms)
        return packed_reply(FieldReply(sequence, status, VERSION, *self.readings, *counts, *limits))


ma = st.integers(-32_768, 32_767)
u8 = st.integers(0, 255)
limits = st.builds(
    DriverLimits, st.integers(1, 32_767), st.integers(1, 2**32 - 1), st.integers(1, 400), ma
)
near = st.integers(0, 5)  # sequences that often repeat or go back
flags = st.integers(0, 7).map(Flag)
commands = st.builds(FieldCommand, near | u8, flags, ma, ma).map(encode_command)
status = st.integers(0, 31).map(DriverStatus)
replies = st.builds(FieldReply, u8, status, *([st.just(0)] * 10))
of_another_kind = st.tuples(u8, u8).map(lambda pair: bytes([0x53, *pair, 1, 2, 3, 4]))
foreign = (
    replies.map(packed_reply)
    | st.binary(min_size=1, max_size=78).map(cobs.encode_with_crc)
    | of_another_kind.map(cobs.encode_with_crc)
)


@st.composite
def damaged(draw):
    frame = bytearray(draw(commands))
    index = draw(st.integers(0, len(frame) - 1))
    frame[index] ^= draw(st.integers(1, 255))
    return bytes(frame)


lines = commands | commands | damaged() | foreign | st.binary(max_size=120)
pauses = st.integers(0, 30) | st.sampled_from([249, 250, 251, 2**31, 2**32 - 1])
readings = st.tuples(ma, ma, st.integers(0, 65_535), st.just(-32_768) | ma)
acts = st.tuples(pauses, lines, st.none() | st.none() | readings)


@pytest.mark.long
@given(limits, st.integers(0, 2**32 - 1), st.lists(acts, max_size=30))
@settings(max_examples=300)
def test_core_and_twin_agree_on_everything(limits, start, acts):
    core = DriverCore(limits, start)
    twin = Twin(limits, start)
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


@pytest.mark.long
@given(limits, st.lists(acts, max_size=30))
def test_no_bytes_break_the_limits(limits, acts):
    core = DriverCore(limits)
    before = (0, 0)
    now = 0
    for pause, data, _ in acts:
        now += min(pause, 300)
        core.push(data, now)
        after = core.currents_ua(now)
        assert max(map(abs, after)) <= 1000 * limits.current_max_ma
        moved = max(abs(a - b) for a, b in zip(after, before, strict=True))
        assert moved <= min(pause, 300) * limits.slew_ma_s
        before = after

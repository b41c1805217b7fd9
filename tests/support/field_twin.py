"""The current driver's firmware core once more, in Python, from docs/reference/wires.md."""

from tetractl.core.errors import WireError
from tetractl.emulate.firmware import CoreEvent
from tetractl.lab import cobs
from tetractl.lab.actuators.field.driver import (
    VERSION,
    DriverStatus,
    FieldFlag,
    FieldReply,
    decode_command,
    encode_reply,
)


def towards_zero(numerator, denominator):
    """Divide as C does."""
    quotient = abs(numerator) // denominator
    return quotient if numerator >= 0 else -quotient


class Twin:
    def __init__(self, limits, now_ms=0):
        self.limits = limits
        self.wished = self.at = (0, 0)  # uA
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
            if cobs.checked_payload(frame)[0] != 0x53:
                return CoreEvent.FOREIGN
            command = decode_command(frame)
        except WireError:
            self.rejected = (self.rejected + 1) % 65_536
            return CoreEvent.REJECTED
        self.received = (self.received + 1) % 65_536
        is_new = self.silent or 1 <= (command.sequence - self.sequence) % 256 <= 127
        runs = FieldFlag.RUN in command.flags
        self.latched |= FieldFlag.EMERGENCY_STOP in command.flags
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
            self.sequence, self.heard, self.silent = command.sequence, now_ms, False
        if FieldFlag.POLL in command.flags and (is_new or not runs):
            self.reply = command.sequence
        return CoreEvent.ACCEPTED if is_new else CoreEvent.STALE

    def stop(self):
        self.wished = (0, 0)
        self.running = self.limited = False

    def watch(self, now_ms):
        room = (now_ms - self.moved) % 2**32 * self.limits.slew_ma_s
        gaps = [wish - at for wish, at in zip(self.wished, self.at, strict=True)]
        peak = max(map(abs, gaps))
        if peak > room:
            gaps = [towards_zero(gap * room, peak) for gap in gaps]
        self.at = tuple(at + gap for at, gap in zip(self.at, gaps, strict=True))
        self.moved = now_ms
        self.silent |= (now_ms - self.heard) % 2**32 >= self.limits.watchdog_ms
        if self.silent or self.latched:
            self.stop()

    def currents_ua(self, now_ms):
        self.watch(now_ms)
        return self.at

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
        sequence, self.reply = self.reply, None
        limits = self.limits.current_max_ma, self.limits.slew_ma_s, self.limits.watchdog_ms
        counts = self.received, self.rejected
        status = self.status(now_ms)
        return encode_reply(FieldReply(sequence, status, VERSION, *self.readings, *counts, *limits))

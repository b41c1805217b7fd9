"""An emulated current driver on a pseudo-terminal: the firmware's own core, and two coils.

The currents follow the core's set points with a first-order lag, L/R of the coils.
"""

import math
from collections.abc import Callable

from tetractl.core.clock import SECOND
from tetractl.emulate.firmware import DriverCore, DriverLimits
from tetractl.emulate.loop import Timeline
from tetractl.emulate.port import PseudoPort
from tetractl.lab.actuators.field.coils import Pair
from tetractl.lab.actuators.field.protocol import DriverStatus, decode_command
from tetractl.lab.cobs import Splitter
from tetractl.lab.errors import WireError

STEP_NS = 1_000_000  # the core is stepped at 1 kHz, as on the driver
LAG_S = 0.004  # 20 mH over 5 ohm


class CurrentDriver:
    """A driver switched on at the timeline's present; `port` is plugged by its owner.

    `currents` [A] are those that flow. Faults set `supply_mv` and `temperature_dc` (tenths of a
    degree Celsius), `mute` (it hears but does not reply), and switch it by `switch`. `tell(event,
    **facts)` is called with each command as it is read from the port, before the driver has it.
    """

    def __init__(
        self,
        timeline: Timeline,
        port: PseudoPort,
        limits: DriverLimits,
        baud: int = 115_200,
        lag_s: float = LAG_S,
        tell: Callable[..., None] = lambda event, **facts: None,
    ) -> None:
        self.port = port
        self.currents: Pair = (0.0, 0.0)
        self.supply_mv, self.temperature_dc = 12_000, 250
        self.powered, self.mute = True, False
        self.garbled = 0  # chunks that came at another speed than the driver's
        self._timeline, self._limits, self._baud = timeline, limits, baud
        self._tell, self._splitter = tell, Splitter()
        self._keep = math.exp(-STEP_NS / SECOND / lag_s)
        self._now_ns = timeline.now_ns
        self._in_ns = self._out_ns = 0  # when the line is free again, either way
        self._core = DriverCore(limits, self._now_ms)

    @property
    def status(self) -> DriverStatus:
        """What the driver says of itself now."""
        return self._core.status(self._now_ms) if self.powered else DriverStatus.SILENT

    def readable(self) -> None:
        """Read what was written to the port; the driver has it after its time on the line."""
        data = self.port.read()
        if not data:
            return
        self._witness(data)
        if self.port.baud() != self._baud:
            self.garbled += 1
            return
        self._in_ns = max(self._timeline.now_ns, self._in_ns) + self._line_ns(data)
        self._timeline.at(self._in_ns, lambda: self.hear(data))

    def hear(self, data: bytes) -> None:
        """Read bytes from the line and reply, byte by byte as a driver does."""
        if not self.powered:
            return
        for byte in data:
            self._core.push(bytes([byte]), self._now_ms)
            reply = self._core.take_reply(self._now_ms)
            if reply and not self.mute:
                self._out_ns = max(self._timeline.now_ns, self._out_ns) + self._line_ns(reply)
                self._timeline.at(self._out_ns, lambda r=reply: self.port.write(r))

    def advance(self, until_ns: int) -> None:
        """Move on to `until_ns` in steps of a millisecond; a shorter rest waits for the next."""
        while self._now_ns + STEP_NS <= until_ns:
            self._now_ns += STEP_NS
            self._step()

    def switch(self, on: bool) -> None:
        """Switch the driver on, which clears its latches, or off."""
        self.powered = on
        if on:
            self._core = DriverCore(self._limits, self._now_ms)

    def _witness(self, data: bytes) -> None:
        for sealed in self._splitter.feed(data):
            try:
                command = decode_command(sealed)
            except WireError:
                self._tell("garbage", hex=sealed.hex())
                continue
            currents = [command.x_ma, command.y_ma]
            self._tell(
                "command",
                sequence=command.sequence,
                flags=int(command.flags),
                currents_ma=currents,
            )

    def _step(self) -> None:
        wished = self._core.currents_ua(self._now_ms) if self.powered else (0, 0)
        x, y = (
            now / 1e6 + self._keep * (before - now / 1e6)
            for now, before in zip(wished, self.currents, strict=True)
        )
        self.currents = x, y
        self._core.measured(round(1000 * x), round(1000 * y), self.supply_mv, self.temperature_dc)

    @property
    def _now_ms(self) -> int:
        return self._now_ns // 1_000_000 & 0xFFFFFFFF

    def _line_ns(self, data: bytes) -> int:
        return len(data) * 10 * SECOND // self._baud

"""The current driver's firmware core, compiled for this machine; see `tetractl.lab.firmware`."""

import ctypes
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from pathlib import Path

from tetractl.lab import firmware
from tetractl.lab.actuators.field.protocol import UNKNOWN_TEMPERATURE, DriverStatus

_REPLY_SIZE = 28


class DriverEvent(IntEnum):
    """What a byte completed."""

    NOTHING = 0
    ACCEPTED = 1
    STALE = 2  # a good frame, old or a duplicate
    REJECTED = 3  # wrong stuffing, length, CRC or flags
    FOREIGN = 4  # a good frame that is no command


@dataclass(frozen=True, slots=True)
class DriverLimits:
    """What is built into a driver: greatest current [mA] of each coil pair and its slew [mA/s],
    watchdog [ms], and the temperature that stops it [0.1 degrees Celsius]."""

    current_max_ma: int
    slew_ma_s: int
    watchdog_ms: int = 250
    temperature_max_dc: int = 800


class _DriverLimits(ctypes.Structure):
    _fields_ = (
        ("current_max_ma", ctypes.c_uint16),
        ("slew_ma_s", ctypes.c_uint32),
        ("watchdog_ms", ctypes.c_uint16),
        ("temperature_max_dc", ctypes.c_int16),
    )


class DriverCore:
    """One driver's firmware core, switched on at `now_ms`.

    Times are milliseconds on any clock, taken modulo 2^32.
    """

    def __init__(
        self, limits: DriverLimits, now_ms: int = 0, library: ctypes.CDLL | None = None
    ) -> None:
        self._library = library or load()
        self._core = ctypes.create_string_buffer(self._library.field_size())
        built_in = _DriverLimits(
            limits.current_max_ma, limits.slew_ma_s, limits.watchdog_ms, limits.temperature_max_dc
        )
        self._library.field_init(self._core, ctypes.byref(built_in), now_ms)

    def push(self, data: bytes, now_ms: int) -> list[DriverEvent]:
        """Read bytes from the serial line; return what they completed."""
        push = self._library.field_push
        events = [DriverEvent(push(self._core, byte, now_ms)) for byte in data]
        return [event for event in events if event is not DriverEvent.NOTHING]

    def currents_ua(self, now_ms: int) -> tuple[int, int]:
        """Return the set points of both currents now [uA]; watchdog and slew are done here."""
        x, y = ctypes.c_int32(), ctypes.c_int32()
        self._library.field_currents(self._core, now_ms, ctypes.byref(x), ctypes.byref(y))
        return x.value, y.value

    def measured(
        self,
        x_ma: int,
        y_ma: int,
        supply_mv: int = 0,
        temperature_dc: int = UNKNOWN_TEMPERATURE,
    ) -> None:
        """Set what the driver has measured; a temperature at its limit stops it for good."""
        self._library.field_measured(self._core, x_ma, y_ma, supply_mv, temperature_dc)

    def status(self, now_ms: int) -> DriverStatus:
        """Return what a reply would say."""
        return DriverStatus(self._library.field_status(self._core, now_ms))

    def take_reply(self, now_ms: int) -> bytes:
        """Return the pending reply, once, or nothing."""
        reply = ctypes.create_string_buffer(_REPLY_SIZE)
        size = self._library.field_take_reply(self._core, now_ms, reply)
        return reply.raw[:size]


@cache
def load(folder: Path | None = None) -> ctypes.CDLL:
    """Return the compiled core, built in `folder` (default: the cache) where needed."""
    library = firmware.load("field", folder)
    address, i16, u32 = ctypes.c_void_p, ctypes.c_int16, ctypes.c_uint32
    library.field_size.restype = ctypes.c_size_t
    library.field_init.argtypes = [address, address, u32]
    library.field_init.restype = None
    library.field_push.argtypes = [address, ctypes.c_uint8, u32]
    library.field_currents.argtypes = [address, u32, address, address]
    library.field_currents.restype = None
    library.field_measured.argtypes = [address, i16, i16, ctypes.c_uint16, i16]
    library.field_measured.restype = None
    library.field_status.argtypes = [address, u32]
    library.field_status.restype = ctypes.c_uint8
    library.field_take_reply.argtypes = [address, u32, address]
    library.field_take_reply.restype = ctypes.c_size_t
    return library

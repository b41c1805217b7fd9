"""The robot's firmware core, compiled for this machine; see `tetractl.lab.firmware`."""

import ctypes
from enum import IntEnum
from functools import cache
from pathlib import Path

from tetractl.lab import firmware
from tetractl.lab.actuators.m3pi.broadcast import Counts, Status

_REPLY_SIZE = 14


class Event(IntEnum):
    """What a byte completed."""

    NOTHING = 0
    ACCEPTED = 1
    STALE = 2  # a good frame, old or a duplicate
    REJECTED = 3  # wrong stuffing, length, CRC, flags or counts
    FOREIGN = 4  # a good frame that is no command


class Core:
    """One robot's firmware core. Times are milliseconds on any clock, taken modulo 2^32."""

    def __init__(self, index: int, library: ctypes.CDLL | None = None) -> None:
        self._library = library or load()
        self._core = ctypes.create_string_buffer(self._library.m3pi_size())
        self._library.m3pi_init(self._core, index)

    def push(self, data: bytes, now_ms: int) -> list[Event]:
        """Take bytes from the radio; return what they completed."""
        push = self._library.m3pi_push
        events = [Event(push(self._core, byte, now_ms)) for byte in data]
        return [event for event in events if event is not Event.NOTHING]

    def wheels(self, now_ms: int) -> Counts:
        """Return the counts to drive with now, which the watchdog may have set to 0."""
        left, right = ctypes.c_int8(), ctypes.c_int8()
        self._library.m3pi_wheels(self._core, now_ms, ctypes.byref(left), ctypes.byref(right))
        return left.value, right.value

    def status(self, now_ms: int) -> Status:
        """Return what a reply would say."""
        return Status(self._library.m3pi_status(self._core, now_ms))

    def set_battery(self, battery_mv: int) -> None:
        """Tell the battery's voltage [mV]; 0 for unknown."""
        self._library.m3pi_set_battery(self._core, battery_mv)

    def take_reply(self, now_ms: int) -> bytes:
        """Return the reply due now, once, or nothing."""
        reply = ctypes.create_string_buffer(_REPLY_SIZE)
        size = self._library.m3pi_take_reply(self._core, now_ms, reply)
        return reply.raw[:size]


@cache
def load(folder: Path | None = None) -> ctypes.CDLL:
    """Return the compiled core, built in `folder` (default: the cache) where needed."""
    library = firmware.load("m3pi", folder)
    address, u8, u32 = ctypes.c_void_p, ctypes.c_uint8, ctypes.c_uint32
    library.m3pi_size.restype = ctypes.c_size_t
    library.m3pi_init.argtypes = [address, u8]
    library.m3pi_init.restype = None
    library.m3pi_push.argtypes = [address, u8, u32]
    library.m3pi_wheels.argtypes = [address, u32, address, address]
    library.m3pi_wheels.restype = None
    library.m3pi_status.argtypes = [address, u32]
    library.m3pi_status.restype = u8
    library.m3pi_set_battery.argtypes = [address, ctypes.c_uint16]
    library.m3pi_set_battery.restype = None
    library.m3pi_take_reply.argtypes = [address, u32, address]
    library.m3pi_take_reply.restype = ctypes.c_size_t
    return library

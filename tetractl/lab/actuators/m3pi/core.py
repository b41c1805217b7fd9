"""The firmware's own core, compiled for this machine: emulated robots run what robots run.

Built once from `firmware/m3pi_core.c` into the user's cache folder, by the compiler in $CC or the
first of cc, gcc and clang.
"""

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from enum import IntEnum
from functools import cache
from pathlib import Path

from tetractl.core.errors import TetractlError
from tetractl.lab.actuators.m3pi.broadcast import Counts, Status

FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared")
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


def compiler() -> str | None:
    """Return the path of a C compiler, or None."""
    names = [os.environ.get("CC", ""), "cc", "gcc", "clang"]
    return next(filter(None, (shutil.which(name) for name in names if name)), None)


def source() -> Path:
    """Return the core's source: in the source tree, or shipped inside the package."""
    here = Path(__file__).resolve()
    for folder in (here.parent / "firmware", here.parents[4] / "firmware"):
        if (folder / "m3pi_core.c").is_file():
            return folder / "m3pi_core.c"
    raise TetractlError("the firmware's source m3pi_core.c is missing from this installation")


@cache
def load(folder: Path | None = None) -> ctypes.CDLL:
    """Return the compiled core, building it in `folder` (default: the cache) where needed."""
    code = source()
    text = code.read_bytes() + code.with_suffix(".h").read_bytes()
    digest = hashlib.sha256(text + " ".join(FLAGS).encode()).hexdigest()[:16]
    path = (folder or _cache()) / f"m3pi_core-{platform.machine()}-{digest}.so"
    if not path.is_file():
        _build(code, path)
    library = ctypes.CDLL(str(path))
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


def _cache() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "tetractl"


def _build(code: Path, path: Path) -> None:
    name = compiler()
    if name is None:
        raise TetractlError(
            "no C compiler found; emulated robots run the compiled firmware",
            hint="install gcc or clang, or set CC",
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as scratch:
        built = Path(scratch) / path.name
        done = subprocess.run(
            [name, *FLAGS, str(code), "-o", str(built)], capture_output=True, text=True
        )
        if done.returncode:
            line = (done.stderr.strip() or "no message").splitlines()[0]
            raise TetractlError(f"{name} could not build the firmware's core: {line}")
        built.replace(path)  # in one step: other processes see all of it or nothing

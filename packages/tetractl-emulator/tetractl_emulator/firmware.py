"""Compiles the firmware's C code for this computer, so that emulated devices run real firmware.

Each core consists of `<name>_core.c` and `framing.c`. The sources are in the repository's
`firmware/`, and a wheel of this package contains a copy. A core is compiled once, into the user's
cache folder, by the compiler in $CC or else by the first that is found of cc, gcc and clang.
"""

import ctypes
import os
import platform
import shutil
import tempfile
from collections.abc import Callable, Mapping
from enum import IntEnum
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

from tetractl.core.errors import TetractlError
from tetractl.lab.actuators.wheel_commands import Status
from tetractl.model.wheels import Counts
from tetractl.tools.cache import cache_folder, digest_files, read_checked_file
from tetractl.tools.children import run_tool, split_printable_lines

_P = ctypes.c_void_p
_U8 = ctypes.c_uint8
_I16 = ctypes.c_int16
_U16 = ctypes.c_uint16
_U32 = ctypes.c_uint32
_SIZE = ctypes.c_size_t
_ALL = {
    "size": (_SIZE,),
    "push": (ctypes.c_int, _P, _U8, _U32),
    "status": (_U8, _P, _U32),
    "take_reply": (_SIZE, _P, _U32, _P),
}
_WHEELED = _ALL | {
    "wheels": (None, _P, _U32, _P, _P),
    "set_battery": (None, _P, _U16),
}
FUNCTIONS = {  # functions of each core: type of the result, types of the arguments
    "m3pi": _WHEELED | {"init": (None, _P, _U8)},
    "twist": _WHEELED | {"init": (None, _P, _U8, _U16)},
    "field": _ALL
    | {
        "init": (None, _P, _P, _U32),
        "currents": (None, _P, _U32, _P, _P),
        "measured": (None, _P, _I16, _I16, _U16, _I16),
    },
}
Library = Mapping[str, Callable[..., Any]]  # the functions of a core by name
FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared")


def compiler() -> str | None:
    """Find a C compiler: the one in the environment variable CC, or else cc, gcc or clang.

    Returns:
        Its path, or None if there is none.
    """
    names = [os.environ.get("CC", ""), "cc", "gcc", "clang"]
    return next(filter(None, (shutil.which(name) for name in names if name)), None)


def source_folder() -> Path:
    """Find the folder of the C sources, in an installed package or in the source tree.

    Raises:
        TetractlError: If the sources are missing.
    """
    module = Path(__file__).resolve()
    for folder in (module.parent / "cores", module.parents[3] / "firmware"):
        if (folder / "framing.c").is_file():
            return folder
    raise TetractlError("the firmware's C sources are missing from this installation")


@cache
def load(name: str, folder: Path | None = None) -> Library:
    """Load a firmware core as a shared library, and compile it first if it is not in the folder.

    Args:
        name: Name of the core, such as "m3pi".
        folder: Folder of the compiled cores. None for the user's cache folder.

    Returns:
        The functions of the core, by their names without the prefix `<name>_`.

    Raises:
        TetractlError: If there is no compiler or no source, or if the source does not compile.
    """
    sources = source_folder()
    c_files = [sources / f"{name}_core.c", sources / "framing.c"]
    source_files = [
        source_file for code in c_files for source_file in (code, code.with_suffix(".h"))
    ]
    source_digest = digest_files(source_files, " ".join(FLAGS))
    library_path = (
        folder or cache_folder()
    ) / f"{name}_core-{platform.machine()}-{source_digest}.so"
    try:
        read_checked_file(library_path)
    except OSError:  # it is missing, or another user's
        _build(c_files, library_path)
    library = ctypes.CDLL(str(library_path))
    functions = {function: library[f"{name}_{function}"] for function in FUNCTIONS[name]}
    for function, (result, *arguments) in FUNCTIONS[name].items():
        functions[function].restype = result
        functions[function].argtypes = arguments
    return functions


def _build(c_files: list[Path], path: Path) -> None:
    """Compile C files to a shared library at a path.

    Raises:
        TetractlError: If there is no compiler, or if the compilation fails.
    """
    compiler_name = compiler()
    if compiler_name is None:
        raise TetractlError(
            "no C compiler was found; emulated devices need one to build their firmware",
            hint="install gcc or clang, or set the environment variable CC to your compiler",
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as scratch:
        built_file = Path(scratch) / path.name
        result = run_tool([compiler_name, *FLAGS, *map(str, c_files), "-o", str(built_file)])
        if result.returncode:
            message = (split_printable_lines(result.stderr) or ["no message"])[0]
            raise TetractlError(
                f"{compiler_name} could not compile the robots' firmware: {message}"
            )
        built_file.replace(path)  # atomic: other processes see the complete file or none


class CoreEvent(IntEnum):
    """The kind of frame that a received byte has completed, if any."""

    NOTHING = 0
    ACCEPTED = 1
    STALE = 2  # a good frame, but old or a duplicate
    REJECTED = 3  # wrong stuffing, length, CRC, flags or counts
    FOREIGN = 4  # a good frame that is not a command


class Core:
    """Base class of compiled firmware cores. Times are in ms on any clock, modulo 2^32.

    Args:
        library: The functions of the core. None to load them.
    """

    name: ClassVar[str]
    reply_size: ClassVar[int]
    number: ClassVar[type[Any]]  # type of the two numbers that `_pair` returns

    def __init__(self, library: Library | None) -> None:
        self._library = library or load(self.name)
        self._memory = ctypes.create_string_buffer(self._library["size"]())
        self._core = ctypes.addressof(self._memory)
        self._reply = ctypes.create_string_buffer(self.reply_size)
        self._one = self.number()
        self._two = self.number()
        self._both = ctypes.addressof(self._one), ctypes.addressof(self._two)

    def push(self, data: bytes, now_ms: int) -> list[CoreEvent]:
        """Pass received bytes to the core.

        Args:
            data: Bytes from the radio or the serial line.
            now_ms: The time [ms].

        Returns:
            An event for each completed frame.
        """
        push = self._library["push"]
        events = [CoreEvent(push(self._core, byte, now_ms)) for byte in data]
        return [event for event in events if event is not CoreEvent.NOTHING]

    def take_reply(self, now_ms: int) -> bytes:
        """Return the reply that is due now. Each reply is returned once.

        Returns:
            The reply, or b"" if none is due.
        """
        size = self._call("take_reply", now_ms, self._reply)
        return self._reply.raw[:size] if size else b""

    def _call(self, function: str, *arguments: Any) -> Any:
        """Call a function of the core with its state and further arguments."""
        return self._library[function](self._core, *arguments)

    def _pair(self, function: str, now_ms: int) -> tuple[int, int]:
        """Call a function of the core that writes two numbers at a time [ms], and return them."""
        self._library[function](self._core, now_ms, *self._both)
        return self._one.value, self._two.value

    def _copy(self) -> Any:
        """Return a copy of the core's state, for functions that change the state."""
        return ctypes.create_string_buffer(self._memory.raw, len(self._memory))


class WheelsCore(Core):
    """Base class of the firmware cores of robots with two wheels."""

    def wheels(self, now_ms: int) -> Counts:
        """Return the present outputs of the left and the right wheel.

        They are counts or speeds [mm/s], depending on the core. They are 0 after the watchdog has
        expired.
        """
        return self._pair("wheels", now_ms)

    def status(self, now_ms: int) -> Status:
        """Return the status flags that a reply would contain now, without changing the core."""
        return Status(self._library["status"](self._copy(), now_ms))

    def set_battery(self, battery_mv: int) -> None:
        """Set the battery voltage that the core reports [mV]. 0 means unknown."""
        self._call("set_battery", battery_mv)


class RobotCore(WheelsCore):
    """The firmware core of an m3pi robot. Its wheel outputs are motor counts.

    Args:
        index: Number of the robot in broadcasts.
        library: The functions of the core. None to load them.
    """

    name = "m3pi"
    reply_size = 14
    number = ctypes.c_int8

    def __init__(self, index: int, library: Library | None = None) -> None:
        super().__init__(library)
        self._call("init", index)


class TwistCore(WheelsCore):
    """The firmware core of a robot that receives lines of text.

    Its wheel outputs are speeds [mm/s].

    Args:
        index: Number of the robot.
        radius_mm: Distance from a wheel to the robot's centre [mm].
        library: The functions of the core. None to load them.
    """

    name = "twist"
    reply_size = 48
    number = ctypes.c_int32

    def __init__(self, index: int, radius_mm: int, library: Library | None = None) -> None:
        super().__init__(library)
        self._call("init", index, radius_mm)

"""Keep compiled functions between runs, instead of in Numba's own cache.

Numba's cache has three faults. It ends the process if one of its files is empty, damaged or cannot
be written. It unpickles any file. And it does not notice that a function in another file was
edited. Here, each file begins with the SHA-256 of its contents. If the sum does not match, the code
is compiled again. If a file cannot be written, a note is printed once.

A wheel for one version of Python and one system also contains compiled files, for all processors of
level x86-64-v3 (`make dist`). They are used if the user's cache has none.
"""

import hashlib
import os
import pickle
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numba
from llvmlite import binding
from numba import njit
from numba.core import event

from tetractl.tools.cache import (
    cache_folder,
    claim,
    compiler_settings,
    compiling,
    digest,
    read_own,
    say_once,
)
from tetractl.tools.kernels import sources
from tetractl.tools.kernels.kernel_compiler import KernelCompiler


class _Internals(NamedTuple):
    """Private functions of Numba that store and restore compiled code."""

    dumps: Callable[..., bytes]
    rebuild: Callable[..., Any]
    reduce: Callable[..., Any]


@cache
def _internals() -> _Internals | None:
    """Return Numba's private functions.

    None if this version of Numba lacks one of them. Then no compiled code is kept.
    """
    try:
        from numba.core import compiler, serialize

        result: Any = compiler.CompileResult
        return _Internals(serialize.dumps, result._rebuild, result._reduce)
    except (ImportError, AttributeError):
        return None


_SUM = hashlib.sha256().digest_size  # bytes of the checksum before a stored kernel
LEVEL = "x86-64-v3"  # processors for which kernels are shipped
SHIPPED = Path(__file__).parent / "shipped"  # folder of the kernels of the package
_NEEDED = "avx avx2 bmi bmi2 cx16 f16c fma lzcnt movbe popcnt sahf sse3 sse4.1 sse4.2 ssse3 xsave"


@cache
def folder() -> Path | None:
    """Return the cache folder for the compiler's present settings. None if it cannot be created.

    Its parent is $NUMBA_CACHE_DIR, or by default the user's cache folder.
    """
    name = f"kernels-{digest((), compiler_settings())}"
    stated = os.environ.get("NUMBA_CACHE_DIR")
    if stated:
        chosen = Path(stated).absolute() / name
        why = claim(chosen)
        if why is None:
            return chosen
        say_once(f"NUMBA_CACHE_DIR is not used: {why}")
    try:
        chosen = cache_folder() / name
        why = claim(chosen)
        if why is None:
            return chosen
    except OSError as error:
        why = error.strerror or str(error)
    say_once(f"compiled code cannot be kept: {why}")
    return None


@cache
def shipped() -> Path | None:
    """Return the folder of compiled code inside the package. None if none runs here.

    None is also returned if settings of the compiler, such as NUMBA_OPT, require other code.
    """
    if not SHIPPED.is_dir() or compiler_settings() != "none":
        return None
    features = binding.get_host_cpu_features()
    return SHIPPED if all(features.get(name) for name in _NEEDED.split()) else None


@dataclass(slots=True)
class CompileTime:
    """How long the compilation of one function took.

    Attributes:
        versions: Number of signatures for which it was compiled.
        own_s: Processor time without that of the functions that it calls [s].
    """

    versions: int = 0
    own_s: float = 0.0


class _Compiling(event.Listener):
    """Calls the functions in `compiling` when numba starts to compile, and adds up the time.

    Attributes:
        spent_s: Processor time that compiling has taken so far [s].
        times: The time of each function, by "module.name".
    """

    def __init__(self) -> None:
        self.spent_s = 0.0
        self.times: dict[str, CompileTime] = {}
        self._begun_s: list[float] = []  # compiling a function compiles those that it calls
        self._called_s: list[float] = []  # time of the functions called by each of these

    def on_start(self, event: Any) -> None:
        for call in tuple(compiling):
            call()
        self._begun_s.append(time.thread_time())
        self._called_s.append(0.0)

    def on_end(self, event: Any) -> None:
        whole_s = time.thread_time() - self._begun_s.pop()
        own_s = whole_s - self._called_s.pop()
        if self._called_s:
            self._called_s[-1] += whole_s
        else:
            self.spent_s += whole_s
        function = event.data["dispatcher"].py_func
        name = f"{function.__module__}.{function.__name__}"
        compile_time = self.times.setdefault(name, CompileTime())
        compile_time.versions += 1
        compile_time.own_s += own_s


_listener = _Compiling()
event.register("numba:compile", _listener)


def computing_s() -> float:
    """Return the processor time of this thread, without the time for compiling [s].

    Only differences of two such times have a meaning.
    """
    return time.thread_time() - _listener.spent_s


def compile_times() -> dict[str, CompileTime]:
    """Return the compile time of each function that this process has compiled, by "module.name".

    Functions that were loaded from the cache are left out.
    """
    return dict(_listener.times)


class KernelCache:
    """The compiled code of one function: a file for each signature, processor and Python."""

    def __init__(self, function: Callable[..., Any], place: Path | None) -> None:
        self._function = function
        self._place = place

    @property
    def cache_path(self) -> str:
        """The folder in which the compiled code is stored."""
        return str(self._place)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load the compiled code for a signature from this cache, or else from the shipped code.

        None if neither has it, or if it is damaged.
        """
        target_context.refresh()
        system = target_context.codegen().magic_tuple()
        own = self._load(self._place, self._key(sig, system), target_context)
        if own is not None:
            return own
        return self._load(shipped(), self._key(sig, (system[0], LEVEL, "")), target_context)

    def _load(self, place: Path | None, key: tuple[Any, ...], target_context: Any) -> Any:
        internals = _internals()
        if place is None or internals is None:
            return None
        try:
            path = self._path(place, key)
            stored = path.read_bytes() if place == SHIPPED else read_own(path)
            if hashlib.sha256(stored[_SUM:]).digest() != stored[:_SUM]:
                raise ValueError("its checksum does not match")
            stored_key, payload = pickle.loads(stored[_SUM:])
            if stored_key == key:
                return internals.rebuild(target_context, *payload)
        except FileNotFoundError:
            pass
        except PermissionError as error:
            say_once(f"{error}: compiled again")
        except Exception as error:  # after any error the code is compiled again
            say_once(f"{place}: the file is damaged, so its code is compiled again: {error}")
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store the code that was compiled for one combination of argument types.

        Nothing is stored if there is no folder. If writing fails, a note is printed and nothing is
        raised.
        """
        internals = _internals()
        if self._place is None or internals is None:
            return
        key = self._key(sig, data.codegen.magic_tuple())
        try:
            stored = internals.dumps((key, internals.reduce(data)))
            with tempfile.NamedTemporaryFile(dir=self._place, delete=False) as file:
                try:
                    file.write(hashlib.sha256(stored).digest() + stored)
                    file.close()
                    Path(file.name).replace(self._path(self._place, key))
                except OSError:
                    with suppress(OSError):
                        Path(file.name).unlink()
                    raise
        except OSError as error:
            say_once(f"compiled code cannot be kept: {self._place}: {error.strerror or error}")

    def _key(self, sig: Any, system: tuple[str, ...]) -> tuple[Any, ...]:
        # with the version of Python, whose objects the code reads
        versions = numba.__version__, sys.implementation.cache_tag
        return sig, *system, *versions, sources.digest(self._function, sig)

    def _path(self, place: Path, key: tuple[Any, ...]) -> Path:
        name = f"{self._function.__module__}.{self._function.__qualname__}"
        tag = hashlib.sha256(f"{name} {key}".encode()).hexdigest()[:16]
        return place / f"{self._function.__name__}-{tag}.kernel"


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator like `numba.njit`, whose compiled code is kept between runs.

    By default, a function is compiled as a kernel, which contains all code that it calls. Numba's
    own compiler would leave the functions that it calls visible to others. A function that was
    compiled in another process may then call one of the same name, of this process.

    The code of a function without a wrapper for Python is kept only within that of kernels.
    """

    chosen: Any = {"pipeline_class": KernelCompiler} | options

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher: Any = njit(**chosen)(function)
        if options.get("no_cpython_wrapper"):
            return dispatcher
        place = folder()
        if _internals() is None:
            say_once(
                f"compiled code cannot be kept, because numba {numba.__version__} is "
                "unknown to tetractl"
            )
        elif place is not None or shipped() is not None:
            dispatcher._cache = KernelCache(function, place)
        return dispatcher

    return decorate

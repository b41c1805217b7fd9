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
    claim_folder,
    compile_listeners,
    compiler_settings,
    digest_files,
    print_note_once,
    read_checked_file,
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


_CHECKSUM_BYTES = hashlib.sha256().digest_size
"""Number of bytes of the checksum at the beginning of a stored kernel."""
SHIPPED_LEVEL = "x86-64-v3"
"""The level of processors for which the package contains compiled kernels."""
SHIPPED = Path(__file__).parent / "shipped"
"""The folder of compiled kernels in the package."""
_NEEDED_FEATURES = (
    "avx avx2 bmi bmi2 cx16 f16c fma lzcnt movbe popcnt sahf sse3 sse4.1 sse4.2 ssse3 xsave"
)


@cache
def find_kernel_folder() -> Path | None:
    """Find the cache folder for the compiler's present settings. None if it cannot be created.

    Its parent is $NUMBA_CACHE_DIR, or by default the user's cache folder.
    """
    name = f"kernels-{digest_files((), compiler_settings())}"
    stated_folder = os.environ.get("NUMBA_CACHE_DIR")
    if stated_folder:
        kernel_folder = Path(stated_folder).absolute() / name
        problem = claim_folder(kernel_folder)
        if problem is None:
            return kernel_folder
        print_note_once(f"NUMBA_CACHE_DIR is not used: {problem}")
    try:
        kernel_folder = cache_folder() / name
        problem = claim_folder(kernel_folder)
        if problem is None:
            return kernel_folder
    except OSError as error:
        problem = error.strerror or str(error)
    print_note_once(f"compiled code cannot be kept: {problem}")
    return None


@cache
def find_shipped_folder() -> Path | None:
    """Find the folder of compiled code inside the package.

    The result is None if the package contains no code for this processor, or if settings of the
    compiler, such as NUMBA_OPT, require other code.
    """
    if not SHIPPED.is_dir() or compiler_settings() != "none":
        return None
    features = binding.get_host_cpu_features()
    return SHIPPED if all(features.get(name) for name in _NEEDED_FEATURES.split()) else None


@dataclass(slots=True)
class CompileTime:
    """The time that the compilation of one function took.

    Attributes:
        versions: Number of signatures for which the function was compiled.
        own_s: Processor time, without the time for the functions that it calls [s].
    """

    versions: int = 0
    own_s: float = 0.0


class _CompileListener(event.Listener):
    """A listener that calls `compile_listeners` when Numba starts to compile, and adds up the time.

    Attributes:
        spent_s: Processor time that compiling has taken so far [s].
        times: The compile time of each function, by "module.name".
    """

    def __init__(self) -> None:
        self.spent_s = 0.0
        self.times: dict[str, CompileTime] = {}
        self._begun_s: list[float] = []  # starts of the compilations that are running, nested
        self._called_s: list[float] = []  # compile time of the functions that each of them calls

    def on_start(self, event: Any) -> None:
        for call in tuple(compile_listeners):
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


_listener = _CompileListener()
event.register("numba:compile", _listener)


def computing_s() -> float:
    """Measure the processor time of this thread, without the time for compiling [s].

    Only the difference of two such times has a meaning.
    """
    return time.thread_time() - _listener.spent_s


def compile_times() -> dict[str, CompileTime]:
    """Return the compile time of each function that this process has compiled, by "module.name".

    Functions that were loaded from the cache are left out.
    """
    return dict(_listener.times)


class KernelCache:
    """The compiled code of one function: a file for each signature, processor and Python."""

    def __init__(self, function: Callable[..., Any], folder: Path | None) -> None:
        self._function = function
        self._folder = folder

    @property
    def cache_path(self) -> str:
        """The folder in which the compiled code is stored."""
        return str(self._folder)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load the compiled code for a signature from this cache, or else from the shipped code.

        None if neither has it, or if it is damaged.
        """
        target_context.refresh()
        system = target_context.codegen().magic_tuple()
        own_code = self._load(self._folder, self._key(sig, system), target_context)
        if own_code is not None:
            return own_code
        return self._load(
            find_shipped_folder(), self._key(sig, (system[0], SHIPPED_LEVEL, "")), target_context
        )

    def _load(self, folder: Path | None, key: tuple[Any, ...], target_context: Any) -> Any:
        internals = _internals()
        if folder is None or internals is None:
            return None
        try:
            path = self._path(folder, key)
            stored = path.read_bytes() if folder == SHIPPED else read_checked_file(path)
            if hashlib.sha256(stored[_CHECKSUM_BYTES:]).digest() != stored[:_CHECKSUM_BYTES]:
                raise ValueError("its checksum does not match")
            stored_key, payload = pickle.loads(stored[_CHECKSUM_BYTES:])
            if stored_key == key:
                return internals.rebuild(target_context, *payload)
        except FileNotFoundError:
            pass
        except PermissionError as error:
            print_note_once(f"{error}: compiled again")
        except Exception as error:  # after any error the code is compiled again
            print_note_once(
                f"{folder}: the file is damaged, so its code is compiled again: {error}"
            )
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store the code that was compiled for one combination of argument types.

        Nothing is stored if there is no folder. If writing fails, a note is printed and nothing is
        raised.
        """
        internals = _internals()
        if self._folder is None or internals is None:
            return
        key = self._key(sig, data.codegen.magic_tuple())
        try:
            stored = internals.dumps((key, internals.reduce(data)))
            with tempfile.NamedTemporaryFile(dir=self._folder, delete=False) as file:
                try:
                    file.write(hashlib.sha256(stored).digest() + stored)
                    file.close()
                    Path(file.name).replace(self._path(self._folder, key))
                except OSError:
                    with suppress(OSError):
                        Path(file.name).unlink()
                    raise
        except OSError as error:
            print_note_once(
                f"compiled code cannot be kept: {self._folder}: {error.strerror or error}"
            )

    def _key(self, sig: Any, system: tuple[str, ...]) -> tuple[Any, ...]:
        # with the version of Python, whose objects the code reads
        versions = numba.__version__, sys.implementation.cache_tag
        return sig, *system, *versions, sources.digest_dependencies(self._function, sig)

    def _path(self, folder: Path, key: tuple[Any, ...]) -> Path:
        name = f"{self._function.__module__}.{self._function.__qualname__}"
        tag = hashlib.sha256(f"{name} {key}".encode()).hexdigest()[:16]
        return folder / f"{self._function.__name__}-{tag}.kernel"


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator like `numba.njit`, whose compiled code is kept between runs.

    By default, a function is compiled as a kernel, which contains all code that it calls. Numba's
    own compiler would leave the functions that it calls visible to others. A function that was
    compiled in another process may then call one of the same name, of this process.

    The code of a function without a wrapper for Python is kept only within that of kernels.
    """

    all_options: Any = {"pipeline_class": KernelCompiler} | options

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher: Any = njit(**all_options)(function)
        if options.get("no_cpython_wrapper"):
            return dispatcher
        place = find_kernel_folder()
        if _internals() is None:
            print_note_once(
                f"compiled code cannot be kept, because numba {numba.__version__} is "
                "unknown to tetractl"
            )
        elif place is not None or find_shipped_folder() is not None:
            dispatcher._cache = KernelCache(function, place)
        return dispatcher

    return decorate

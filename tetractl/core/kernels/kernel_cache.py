"""Keeps compiled kernels between runs, in place of numba's own cache.

Numba's cache ends the process if one of its files is empty, damaged or cannot be written, unpickles
any file, and does not see that a function in another file was edited. Here each file begins with
the SHA-256 of its contents; if the sum does not match, the code is compiled again. If a file cannot
be written, a note is printed once.
"""

import hashlib
import os
import pickle
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba import njit
from numba.core import event
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

from tetractl.core.cache import cache_folder, claim, compiler_settings, compiling, digest, say_once
from tetractl.core.kernels import sources

_SUM = hashlib.sha256().digest_size


@cache
def folder() -> Path | None:
    """Return the cache folder for the compiler's present settings, None if it cannot be made.

    Its parent is $NUMBA_CACHE_DIR, or by default the user's cache folder.
    """
    name = f"kernels-{digest((), compiler_settings())}"
    if given := os.environ.get("NUMBA_CACHE_DIR"):
        chosen = Path(given).absolute() / name
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
    say_once(f"compiled code is not kept: {why}")
    return None


class _Compiling(event.Listener):
    """Calls the functions in `compiling` when numba starts to compile."""

    def on_start(self, event: Any) -> None:
        for call in tuple(compiling):
            call()

    def on_end(self, event: Any) -> None:
        pass


event.register("numba:compile", _Compiling())


class KernelCache:
    """The compiled code of one function: a file for each signature, processor and Python."""

    def __init__(self, function: Callable[..., Any], place: Path) -> None:
        self._function, self._place = function, place

    @property
    def cache_path(self) -> str:
        """The folder of the cache's files."""
        return str(self._place)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled code for a signature, None if the cache has none or it is damaged."""
        target_context.refresh()
        key = self._key(sig, target_context.codegen())
        path = self._path(key)
        try:
            stored = path.read_bytes()
            if hashlib.sha256(stored[_SUM:]).digest() != stored[:_SUM]:
                raise ValueError("its checksum does not match")
            kept, payload = pickle.loads(stored[_SUM:])
            return CompileResult._rebuild(target_context, *payload) if kept == key else None
        except FileNotFoundError:
            return None
        except Exception as error:  # after any error the code is compiled again
            say_once(f"{path.parent}: damaged, compiled again: {error}")
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store the compiled code for a signature."""
        key = self._key(sig, data.codegen)
        try:
            stored = dumps((key, data._reduce()))
            with tempfile.NamedTemporaryFile(dir=self._place, delete=False) as file:
                try:
                    file.write(hashlib.sha256(stored).digest() + stored)
                    file.close()
                    Path(file.name).replace(self._path(key))
                except OSError:
                    with suppress(OSError):
                        Path(file.name).unlink()
                    raise
        except OSError as error:
            say_once(f"compiled code is not kept: {self._place}: {error.strerror or error}")

    def _key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        # with the version of Python, whose objects the code reads
        system = codegen.magic_tuple(), numba.__version__, sys.implementation.cache_tag
        return sig, *system, sources.digest(self._function, sig)

    def _path(self, key: tuple[Any, ...]) -> Path:
        name = f"{self._function.__module__}.{self._function.__qualname__}"
        tag = hashlib.sha256(f"{name} {key}".encode()).hexdigest()[:16]
        return self._place / f"{self._function.__name__}-{tag}.kernel"


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator like `numba.njit`, whose compiled code is kept between runs.

    The code of a function without a wrapper for Python is kept only within that of kernels.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher: Any = njit(**options)(function)
        place = None if options.get("no_cpython_wrapper") else folder()
        if place is not None:
            dispatcher._cache = KernelCache(function, place)
        return dispatcher

    return decorate

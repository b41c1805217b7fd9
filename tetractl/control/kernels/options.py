"""The compiler options of kernels and of the functions they call."""

from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any

from numba import njit
from numba.extending import overload

from tetractl.control.kernels.part import PartCompiler

FAST = {"contract", "reassoc", "arcp", "nsz"}  # NaN and inf are kept, to check costs for them
_PART: Any = {
    "nogil": True,
    "error_model": "numpy",
    "forceinline": True,
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "pipeline_class": PartCompiler,
}
_ENTRY: Any = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
INLINE_FAST: Any = _PART | {"fastmath": FAST}
"""For functions that a kernel calls, which are inlined. A call would cost as much as the loop, and
a freshly compiled kernel would call other machine code than one from the cache, so that results
would differ in the last bits from run to run.
"""
ENTRY_FAST: Any = _ENTRY | {"fastmath": FAST}
"""For kernels, which Python calls."""
INLINE_STRICT, ENTRY_STRICT = _PART, _ENTRY
"""For functions that must round exactly as NumPy does."""
INLINE = {"nogil": True, "fastmath": FAST, "error_model": "numpy", "inline": "always"}
"""For functions of scalars, inlined at each call."""


@cache
def inlined(function: FunctionType) -> Callable[..., Any]:
    """Return a plain function of scalars, compiled together with the plain functions it calls.

    Motions and shapes are plain Python without compiler decorators, so that checking a spec does
    not import the compiler.
    """
    code, scope = function.__code__, function.__globals__
    called = {name: scope.get(name) for name in code.co_names}
    compiled = {name: inlined(f) for name, f in called.items() if isinstance(f, FunctionType)}
    return njit(**INLINE)(FunctionType(code, {**scope, **compiled}, function.__name__))


def entries(rows: Any, i: int, columns: Any) -> Any:
    """Return the tuple of rows[i, c] for each c in a tuple of columns."""


@overload(entries, jit_options=INLINE_FAST)
def _entries(rows, i, columns):
    def several(rows, i, columns):
        a, b, c = columns[:3]
        first = rows[i, a], rows[i, b], rows[i, c]
        return first + entries(rows, i, columns[3:])

    match len(columns):
        case 0:
            return lambda rows, i, columns: ()
        case 1:
            return lambda rows, i, columns: (rows[i, columns[0]],)
        case 2:
            return lambda rows, i, columns: (rows[i, columns[0]], rows[i, columns[1]])
        case _:
            return several

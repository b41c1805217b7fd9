"""The compiler options of kernels and of the functions they call."""

from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any

from numba import njit

from tetractl.tools.kernels.kernel_compiler import KernelCompiler, PartCompiler

# NaN and inf are kept, to check costs for them. With "reassoc" or "contract", sums would depend on
# the version of Python, whose bytecode the compiler reads.
FAST_MATH = {"arcp", "nsz"}
VECTOR_SIZE = 8
"""Number of 64-bit floats in the widest vector of any processor, and in a cache line."""
_COMMON: Any = {
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    "_nrt": True,  # count references to arrays: a kernel that creates arrays needs this
}
_PART: Any = _COMMON | {
    "forceinline": False,
    "no_cpython_wrapper": True,
    "pipeline_class": PartCompiler,
}
_INLINE: Any = _PART | {"forceinline": True}
_ENTRY: Any = _COMMON | {"pipeline_class": KernelCompiler}
_UNCOUNTED = {"_nrt": False}
"""Do not count references to arrays, which would take a fifth of a search's time.

Such kernels and their parts cannot create arrays: Python passes the arrays that they fill. All
functions of a kernel that pass on arrays need the same option.
"""
PART_FAST: Any = _PART | _UNCOUNTED | {"fastmath": FAST_MATH}
"""For parts that a kernel calls from several places, and that take longer than a call.

Inlining may change the last bits: with "arcp", the compiler may replace a division by a product
where it sees more of the program. If the options of a part change, compare digests of trials.
"""
INLINE_FAST: Any = _INLINE | _UNCOUNTED | {"fastmath": FAST_MATH}
"""For parts that are inlined at each call: a call would cost as much as they do.

Loops become vector code only if all that they call is inlined.
"""
ENTRY_FAST: Any = _ENTRY | _UNCOUNTED | {"fastmath": FAST_MATH}
"""For kernels, which Python calls. They create no arrays: Python passes those that they fill."""
PART_EXACT: Any = _PART | {"fastmath": False}
INLINE_EXACT: Any = _INLINE | {"fastmath": False}
ENTRY: Any = _ENTRY | {"fastmath": False}
"""The same for kernels that compute the same bits as their reference implementations.

An option that is not set is inherited from the function that happens to be compiled first with a
call of this one.
"""


def wrap_called_functions(function: Callable[..., Any], wrap: Callable[..., Any]) -> FunctionType:
    """Return a copy of a plain function that calls compiled functions instead of plain functions.

    Models are plain Python without compiler decorators, so that checking a spec does not import the
    compiler.

    Args:
        function: The plain function.
        wrap: Function that compiles a called function as a part of a kernel.
    """
    assert isinstance(function, FunctionType)
    code = function.__code__
    module_globals = function.__globals__
    called = {name: module_globals.get(name) for name in code.co_names}
    wrapped = {
        name: wrap(value) for name, value in called.items() if isinstance(value, FunctionType)
    }
    return FunctionType(code, {**module_globals, **wrapped}, function.__name__)


@cache
def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a plain function of scalars together with the plain functions that it calls.

    The options are INLINE_FAST, so the last bits of a result may differ from Python's.
    """
    return njit(**INLINE_FAST)(wrap_called_functions(function, inlined))


@cache
def exact(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a plain function as a part of a kernel that returns exactly the same bits.

    The compiler may neither reorder nor merge its operations, in contrast to `inlined`.
    """
    return njit(**INLINE_EXACT)(wrap_called_functions(function, exact))


def shared_exact(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a plain function like `exact`, but once for all places where a kernel calls it.

    It is for functions that take longer than a call, such as a sine, outside of vector code.
    """
    return njit(**PART_EXACT)(wrap_called_functions(function, exact))


@cache
def create_selector(size: int) -> Callable[..., Any]:
    """Create a compiled function (first, one, other) that selects one of two tuples.

    The function returns `one` if `first` is true, otherwise `other`. Vector code needs a selection
    in this form.

    Args:
        size: Length of both tuples.
    """
    selected_entries = "".join(f"one[{k}] if first else other[{k}], " for k in range(size))
    return njit(**INLINE_FAST)(eval(f"lambda first, one, other: ({selected_entries})"))


def create_entry_reader(size: int) -> Callable[..., Any]:
    """Create a compiled function that returns the first `size` entries of a row as a tuple.

    The row must have at least that many entries, because this is not checked.
    """
    row_entries = "".join(f"row[{k}], " for k in range(size))
    return njit(**INLINE_FAST)(eval(f"lambda row: ({row_entries})"))  # numba knows no shorter way

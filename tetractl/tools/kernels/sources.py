"""Find the files and constants on which the compiled code of a function depends."""

import sys
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core import types
from numba.extending import is_jitted

from tetractl.tools.cache import digest_files as files_digest


def digest_dependencies(function: Callable[..., Any], sig: Any) -> str:
    """Compute 12 hex digits of everything on which the compiled code of a function depends.

    It depends on the signature; on the file of each function that it calls, directly or not; on the
    constants that these functions name; and on the modules of the classes of its arguments. A
    motion is such a class, whose module may use other modules in its folder.
    """
    files = set[Path]()
    constants = list[str]()
    for compiled_function, named_values in _find_compiled_functions(function):
        overloads = (value for _, value in named_values if isinstance(value, FunctionType))
        codes = [function.__code__ for function in (compiled_function, *overloads)]
        files.update(Path(code.co_filename) for code in codes)  # an overload's is in the same file
        constants += [f"{name} = {_format_constant(value)}" for name, value in named_values]
    for tuple_class in _find_tuple_classes(sig if isinstance(sig, tuple) else sig.args):
        files.update(_module_files(tuple_class.__module__))
    return files_digest([file for file in files if file.is_file()], "\n".join(constants))


NamedValues = list[tuple[str, Any]]


def _find_compiled_functions(
    function: Callable[..., Any],
) -> Iterator[tuple[FunctionType, NamedValues]]:
    """Yield a plain function and all functions compiled into it, with the names they use.

    Each function occurs once.
    """
    visited = set[FunctionType]()
    to_visit = [function]
    while to_visit:
        current = to_visit.pop()
        if not isinstance(current, FunctionType) or current in visited:
            continue
        visited.add(current)
        named_values = list(_find_named_values(current))
        yield current, named_values
        values = [value for _, value in named_values]
        for overload in (value for value in values if isinstance(value, FunctionType)):
            values = [*values, *overload.__globals__.values()]
        to_visit += [value.py_func for value in values if is_jitted(value)]


def _find_named_values(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Yield the name and the value of every variable outside a function that its code refers to.

    Built-in names are left out.
    """
    closure_cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    yield from ((name, cell.cell_contents) for name, cell in closure_cells)
    names = sorted(_find_names(function.__code__))
    for name in names:
        if name in function.__globals__:
            value = function.__globals__[name]
            yield name, value
            if isinstance(value, ModuleType) and value.__name__ not in ("math", "numpy"):
                yield from ((n, vars(value)[n]) for n in names if n in vars(value))


def _format_constant(value: Any) -> str:
    """Format the value of a constant in compiled code as a text that identifies the value.

    The text is empty for anything but numbers, strings, tuples and arrays.
    """
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, tuple):
        return f"({', '.join(map(_format_constant, value))})"
    return repr(value) if isinstance(value, bool | int | float | complex | str | np.generic) else ""


def _find_names(code: CodeType) -> set[str]:
    inner = (constant for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*map(_find_names, inner))


def _find_tuple_classes(numba_types: Iterable[Any]) -> Iterator[type[Any]]:
    """Yield the classes of the named tuples among types, at any depth.

    A class can occur repeatedly.
    """
    for numba_type in numba_types:
        if isinstance(numba_type, types.NamedTuple | types.NamedUniTuple):
            yield numba_type.instance_class
        if isinstance(
            numba_type, types.Tuple | types.UniTuple | types.NamedTuple | types.NamedUniTuple
        ):
            yield from _find_tuple_classes(tuple(numba_type))


@cache
def _module_files(name: str) -> frozenset[Path]:
    """Return the Python files in the folder of a module's package, without subfolders.

    If the module is in no package, return only its own file. A built-in module has no files.
    """
    origin = sys.modules[name].__file__
    if origin is None:
        return frozenset()
    file = Path(origin)
    is_in_package = (file.parent / "__init__.py").exists()
    return frozenset(file.parent.glob("*.py") if is_in_package else (file,))

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

from tetractl.tools.cache import digest_files


def digest_dependencies(function: Callable[..., Any], signature: Any) -> str:
    """Compute a digest of everything on which the compiled code of a function depends.

    The code depends on the signature, on the files of all functions that the function calls, on the
    constants that these functions use, and on the modules of the classes of the arguments. A motion
    is such a class, whose module may use other modules in its folder.

    Args:
        function: The plain Python function.
        signature: The Numba signature of the compiled function, or a tuple of the Numba types of
            its arguments.

    Returns:
        12 hex digits.
    """
    files = set[Path]()
    constants = list[str]()
    for compiled_function, named_values in _find_compiled_functions(function):
        files.add(Path(compiled_function.__code__.co_filename))
        for name, value in named_values:
            constants.append(f"{name} = {_format_constant(value)}")
            if isinstance(value, FunctionType):  # an overload, in the file of its implementation
                files.add(Path(value.__code__.co_filename))
    argument_types = signature if isinstance(signature, tuple) else signature.args
    for tuple_class in _find_tuple_classes(argument_types):
        files.update(_find_module_files(tuple_class.__module__))
    source_files = [file for file in files if file.is_file()]
    return digest_files(source_files, "\n".join(constants))


NamedValues = list[tuple[str, Any]]
"""Names that a function uses, with their values."""


def _find_compiled_functions(
    function: Callable[..., Any],
) -> Iterator[tuple[FunctionType, NamedValues]]:
    """Yield a plain function and all functions that are compiled into it, each only once.

    Each function comes with the names that it uses and their values.
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
        overloads = [value for value in values if isinstance(value, FunctionType)]
        for overload in overloads:
            values.extend(overload.__globals__.values())
        to_visit.extend(value.py_func for value in values if is_jitted(value))


def _find_named_values(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Yield the name and the value of each variable that a function uses from outside.

    If the variable is a module other than `math` and `numpy`, the names that the function may use
    from this module follow. Built-in names are left out.
    """
    closure_cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    for name, cell in closure_cells:
        yield name, cell.cell_contents
    names = sorted(_find_names(function.__code__))
    for name in names:
        if name not in function.__globals__:
            continue
        value = function.__globals__[name]
        yield name, value
        if isinstance(value, ModuleType) and value.__name__ not in ("math", "numpy"):
            for attribute_name in names:
                if attribute_name in vars(value):
                    yield attribute_name, vars(value)[attribute_name]


def _format_constant(value: Any) -> str:
    """Format the value of a constant in compiled code as a string that identifies the value.

    The string is empty for anything other than numbers, strings, tuples and arrays.
    """
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, tuple):
        return f"({', '.join(map(_format_constant, value))})"
    if isinstance(value, bool | int | float | complex | str | np.generic):
        return repr(value)
    return ""


def _find_names(code: CodeType) -> set[str]:
    """Find the names that code uses, including the code of functions defined inside it."""
    names = set(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            names |= _find_names(constant)
    return names


def _find_tuple_classes(numba_types: Iterable[Any]) -> Iterator[type[Any]]:
    """Yield the classes of the named tuples among Numba types, also inside other tuples.

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
def _find_module_files(name: str) -> frozenset[Path]:
    """Find the Python files in the folder of a module's package, without subfolders.

    If the module is in no package, the result is only its own file. A built-in module has no files.
    """
    origin = sys.modules[name].__file__
    if origin is None:
        return frozenset()
    file = Path(origin)
    is_in_package = (file.parent / "__init__.py").exists()
    if is_in_package:
        return frozenset(file.parent.glob("*.py"))
    return frozenset([file])

"""The functions of `elementary` for arrays, with the same bits as for single numbers.

NumPy's own functions differ in the last bits from processor to processor. Arguments may be numbers
or arrays of shapes that broadcast. Small arrays, such as one number per robot, are computed one
element at a time, which takes about a microsecond each. Arrays of LARGE elements or more are
computed by `elementary_arrays`.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tetractl.core import elementary
from tetractl.core import elementary_arrays as arrays

Floats = NDArray[np.float64]

LARGE = 64
"""Minimum number of elements for which array operations are faster than a loop."""


def _elementwise(
    function: Callable[..., float],
    of_arrays: Callable[..., Floats],
    are_ordinary: Callable[..., NDArray[np.bool_]],
    arity: int = 1,
) -> Callable[..., Floats]:
    """Make a function of arrays from a function of numbers, with the same bits.

    Args:
        function: The function of numbers.
        of_arrays: The same function for large arrays of ordinary arguments.
        are_ordinary: Checks which arguments `of_arrays` accepts. The others are computed one by
            one.
        arity: Number of arguments.
    """
    single = _one_by_one(function)

    def apply_to_large(arguments: list[Floats]) -> Floats:
        alike = np.broadcast_arrays(*arguments)
        ordinary = are_ordinary(*alike)
        if ordinary.all():
            return of_arrays(*alike)
        values = np.empty(ordinary.shape)
        values[ordinary] = of_arrays(*(argument[ordinary] for argument in alike))
        values[~ordinary] = single(*(argument[~ordinary] for argument in alike))
        return values

    def apply(*arguments: ArrayLike) -> Floats:
        floats = [np.asarray(argument, np.float64) for argument in arguments]
        for argument in floats:
            if argument.size >= LARGE:
                # NaN stands for what is unknown, and remains NaN
                with np.errstate(invalid="ignore", over="ignore"):
                    return apply_to_large(floats)
        return single(*floats)[()]  # a number for numbers

    apply.__doc__ = function.__doc__
    return apply


def _one_by_one(function: Callable[..., float]) -> Callable[..., Floats]:
    """Make a function of small arrays that calls a function of numbers for each element."""

    def apply(*arguments: Floats) -> Floats:
        shape = arguments[0].shape
        for argument in arguments[1:]:
            if argument.shape != shape:
                arguments = np.broadcast_arrays(*arguments)
                shape = arguments[0].shape
        if len(shape) == 1:
            return np.array([*map(function, *(a.tolist() for a in arguments))], np.float64)
        values = map(function, *(argument.ravel().tolist() for argument in arguments))
        return np.array([*values], np.float64).reshape(shape)

    return apply


sin = _elementwise(elementary.sin, arrays.sin, arrays.is_angle)
cos = _elementwise(elementary.cos, arrays.cos, arrays.is_angle)
exp = _elementwise(elementary.exp, arrays.exp, arrays.is_finite_exponent)
expm1 = _elementwise(elementary.expm1, arrays.expm1, arrays.is_exponent)
log = _elementwise(elementary.log, arrays.log, arrays.is_positive)
log1p = _elementwise(elementary.log1p, arrays.log1p, arrays.is_above_minus_1)
tanh = _elementwise(elementary.tanh, arrays.tanh, arrays.is_half_exponent)
atan2 = _elementwise(elementary.atan2, arrays.atan2, arrays.is_off_origin, arity=2)

_small_hypot = _one_by_one(elementary.hypot)


def hypot(x: ArrayLike, y: ArrayLike) -> Floats:
    """Compute the lengths of vectors (x, y), numbers or arrays that broadcast."""
    x = np.asarray(x, dtype=np.float64)
    y = np.asarray(y, dtype=np.float64)
    if x.size < LARGE and x.shape == y.shape:
        return _small_hypot(x, y)[()]
    size = np.maximum(np.abs(x), np.abs(y))
    ordinary = (size > 0) & (size < np.inf)
    unit = np.where(ordinary, size, 1.0)
    length = unit * np.sqrt(np.square(np.divide(x, unit)) + np.square(np.divide(y, unit)))
    return np.where(ordinary, length, size)[()]

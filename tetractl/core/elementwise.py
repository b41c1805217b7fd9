"""The functions of `elementary` for arrays, with the same bits as for single numbers.

NumPy's own functions differ in the last bits from processor to processor. Arguments may be numbers
or arrays of shapes that broadcast. Small arrays, such as one number per robot, are computed one
element at a time, which takes about a microsecond each. Arrays of ARRAY_SIZE_MIN elements or
more are computed by `elementary_arrays`.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tetractl.core import elementary
from tetractl.core import elementary_arrays as arrays

Floats = NDArray[np.float64]

ARRAY_SIZE_MIN = 64
"""Minimum number of elements for which array operations are faster than a loop."""


def _vectorise(
    function: Callable[..., float],
    array_function: Callable[..., Floats],
    accepts: Callable[..., NDArray[np.bool_]],
    arity: int = 1,
) -> Callable[..., Floats]:
    """Make a function of arrays of any size from a function of numbers, with the same bits.

    Args:
        function: The function of numbers.
        array_function: The same function for large arrays of arguments that it accepts.
        accepts: Checks which arguments `array_function` accepts. The others are computed one by
            one.
        arity: Number of arguments of the function.
    """
    evaluate_each = _vectorise_by_loop(function)

    def evaluate_large(arguments: list[Floats]) -> Floats:
        broadcast_arguments = np.broadcast_arrays(*arguments)
        is_accepted = accepts(*broadcast_arguments)
        if is_accepted.all():
            return array_function(*broadcast_arguments)
        values = np.empty(is_accepted.shape)
        values[is_accepted] = array_function(
            *(argument[is_accepted] for argument in broadcast_arguments)
        )
        values[~is_accepted] = evaluate_each(
            *(argument[~is_accepted] for argument in broadcast_arguments)
        )
        return values

    def evaluate(*arguments: ArrayLike) -> Floats:
        floats = [np.asarray(argument, np.float64) for argument in arguments]
        for argument in floats:
            if argument.size >= ARRAY_SIZE_MIN:
                # NaN stands for an unknown number, and remains NaN
                with np.errstate(invalid="ignore", over="ignore"):
                    return evaluate_large(floats)
        return evaluate_each(*floats)[()]  # [()] converts an array without axes to a number

    evaluate.__doc__ = function.__doc__
    return evaluate


def _vectorise_by_loop(function: Callable[..., float]) -> Callable[..., Floats]:
    """Make a function of small arrays, which calls a function of numbers for each element."""

    def evaluate(*arguments: Floats) -> Floats:
        shape = arguments[0].shape
        for argument in arguments[1:]:
            if argument.shape != shape:
                arguments = np.broadcast_arrays(*arguments)
                shape = arguments[0].shape
        if len(shape) == 1:
            return np.array([*map(function, *(a.tolist() for a in arguments))], np.float64)
        values = map(function, *(argument.ravel().tolist() for argument in arguments))
        return np.array([*values], np.float64).reshape(shape)

    return evaluate


sin = _vectorise(elementary.sin, arrays.sin, arrays.accepts_sine)
cos = _vectorise(elementary.cos, arrays.cos, arrays.accepts_sine)
exp = _vectorise(elementary.exp, arrays.exp, arrays.accepts_exp)
expm1 = _vectorise(elementary.expm1, arrays.expm1, arrays.accepts_expm1)
log = _vectorise(elementary.log, arrays.log, arrays.accepts_log)
log1p = _vectorise(elementary.log1p, arrays.log1p, arrays.accepts_log1p)
tanh = _vectorise(elementary.tanh, arrays.tanh, arrays.accepts_tanh)
atan2 = _vectorise(elementary.atan2, arrays.atan2, arrays.accepts_atan2, arity=2)

_small_hypot = _vectorise_by_loop(elementary.hypot)


def hypot(x: ArrayLike, y: ArrayLike) -> Floats:
    """Compute the lengths of vectors (x, y), numbers or arrays that broadcast."""
    x = np.asarray(x, dtype=np.float64)
    y = np.asarray(y, dtype=np.float64)
    if x.size < ARRAY_SIZE_MIN and x.shape == y.shape:
        return _small_hypot(x, y)[()]
    scale = np.maximum(np.abs(x), np.abs(y))
    is_accepted = (scale > 0) & (scale < np.inf)
    divisor = np.where(is_accepted, scale, 1.0)
    length = divisor * np.sqrt(np.square(np.divide(x, divisor)) + np.square(np.divide(y, divisor)))
    return np.where(is_accepted, length, scale)[()]

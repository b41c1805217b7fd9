"""The functions of `elementary` for arrays, with the same bits as for single numbers.

NumPy's own functions differ in the last bits from processor to processor. Arguments may be numbers
or arrays of shapes that broadcast. An element takes about a microsecond, so these functions suit
arrays of a few robots; loops over many particles belong into a kernel.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tetractl.core import elementary

Floats = NDArray[np.float64]


def _elementwise(function: Callable[..., float]) -> Callable[..., Floats]:
    """Make a function of arrays from a function of numbers."""
    ufunc = np.frompyfunc(function, function.__code__.co_argcount, 1)

    def apply(*arguments: ArrayLike) -> Floats:
        floats = (np.asarray(argument, dtype=np.float64) for argument in arguments)
        with np.errstate(invalid="ignore"):  # NaN stands for what is unknown, and remains NaN
            values = ufunc(*floats)
        return np.asarray(values, dtype=np.float64)[()]  # a number for numbers

    apply.__doc__ = function.__doc__
    return apply


sin = _elementwise(elementary.sin)
cos = _elementwise(elementary.cos)
exp = _elementwise(elementary.exp)
expm1 = _elementwise(elementary.expm1)
log = _elementwise(elementary.log)
log1p = _elementwise(elementary.log1p)
tanh = _elementwise(elementary.tanh)
atan2 = _elementwise(elementary.atan2)


def hypot(x: ArrayLike, y: ArrayLike) -> Floats:
    """Compute the lengths of vectors (x, y)."""
    size = np.maximum(np.abs(x), np.abs(y))
    ordinary = (size > 0) & (size < np.inf)
    unit = np.where(ordinary, size, 1.0)
    length = unit * np.sqrt(np.square(np.divide(x, unit)) + np.square(np.divide(y, unit)))
    return np.where(ordinary, length, size)[()]

"""Whether two records are the same to the last bit."""

import dataclasses
import struct
from typing import Any

import numpy as np


def same(one: Any, two: Any) -> bool:
    """Compare dataclasses, arrays, tuples and floats bit for bit; NaN is the same as itself."""
    if isinstance(one, np.ndarray):
        return (
            isinstance(two, np.ndarray)
            and (one.dtype, one.shape) == (two.dtype, two.shape)
            and one.tobytes() == two.tobytes()
        )
    if isinstance(one, float):
        return isinstance(two, float) and struct.pack("<d", one) == struct.pack("<d", two)
    if type(one) is not type(two):
        return False
    if isinstance(one, tuple | list):
        return len(one) == len(two) and all(map(same, one, two))
    if dataclasses.is_dataclass(one):
        fields = [field.name for field in dataclasses.fields(one)]
        return all(same(getattr(one, name), getattr(two, name)) for name in fields)
    return one == two

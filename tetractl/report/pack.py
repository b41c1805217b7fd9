"""Arrays as text for a page: base64 of little-endian numbers, unpacked by assets/data.js."""

import base64
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

MISSING = -32768
"""What stands for NaN among 16-bit numbers."""
LARGEST = 32767


def floats(values: ArrayLike) -> dict[str, Any]:
    """Return an array in single precision: {"f4": base64}."""
    return {"f4": _text(np.asarray(values, dtype="<f4"))}


def rounded(values: ArrayLike) -> dict[str, Any]:
    """Return an array in 16 bits: {"i2": base64, "scale": s, "offset": o}, value = o + s i.

    The error of a value is at most 1/131,068 of the extent of all values. What is not finite
    becomes `MISSING`.
    """
    wanted = np.asarray(values, dtype=float)
    finite = np.isfinite(wanted)
    least, most = (wanted[finite].min(), wanted[finite].max()) if finite.any() else (0.0, 0.0)
    offset = least / 2 + most / 2
    scale = (most / 2 - least / 2) / LARGEST
    if not (scale > 0 and math.isfinite(scale)):
        scale = 1.0
    steps = np.rint((np.where(finite, wanted, offset) - offset) / scale)
    packed = np.where(finite, np.clip(steps, -LARGEST, LARGEST), MISSING).astype("<i2")
    return {"i2": _text(packed), "scale": float(scale), "offset": float(offset)}


def _text(values: "np.ndarray[Any, Any]") -> str:
    return base64.b64encode(values.tobytes()).decode()

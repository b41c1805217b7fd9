"""Pack columns of numbers without loss, in a form that zstd compresses well.

`pack_columns` takes these steps, and `unpack_columns` reverses them:

1. The bits of each number are read as an integer. All sums and differences below wrap around at its
   size, so that any bits can be restored.
2. Each column is replaced by its fourth differences, as if zeros preceded it. Numbers that change
   smoothly become small. For example, the first differences of 100 102 104 106 are 100 2 2 2, and
   the second differences are 100 -98 0 0. A single row stays as it is.
3. Small negative integers are mapped to small positive ones: 2 n for n >= 0 and -2 n - 1 for n < 0.
   For example, 0 -1 1 -2 become 0 1 2 3.
4. The lowest bytes of all numbers come first, column after column, then the next higher bytes. So
   the high bytes, which are nearly all 0, are together.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

DIFFERENCES = 4
"""Order of the differences by which the numbers of a packed column are replaced."""


def pack_columns(columns: NDArray[Any]) -> bytes:
    """Compress columns of numbers, such as poses, for a message of the log.

    `columns` has the shape (M, C), with numbers of 4 or 8 bytes. See docs/reference/log-format.md.
    """
    integers = np.ascontiguousarray(columns).view(f"<i{columns.itemsize}")
    if len(integers) > 1:
        leading_zeros = np.zeros((DIFFERENCES, integers.shape[1]), integers.dtype)
        integers = np.diff(np.concatenate([leading_zeros, integers]), DIFFERENCES, axis=0)
    sign_bit = 8 * integers.itemsize - 1
    zigzag = (integers << 1) ^ (integers >> sign_bit)
    by_column = np.ascontiguousarray(zigzag.T)
    by_number = by_column.view(np.uint8).reshape(-1, integers.itemsize)
    return by_number.T.tobytes()


def unpack_columns(data: bytes, column_count: int, dtype: str) -> NDArray[Any]:
    """Restore the columns of numbers that `pack_columns` has packed, shape (M, `column_count`).

    Empty bytes give no rows.

    Args:
        data: The packed bytes.
        column_count: Number of columns.
        dtype: Type of the numbers, such as "<f8".

    Raises:
        ValueError: If the number of bytes is wrong.
    """
    if not data:
        return np.zeros((0, column_count), dtype)
    size = np.dtype(dtype).itemsize
    planes = np.frombuffer(data, np.uint8).reshape(size, column_count, -1)
    by_number = np.ascontiguousarray(planes.transpose(2, 1, 0))
    zigzag = by_number.view(f"<u{size}")[..., 0]
    integers = (zigzag >> 1) ^ -(zigzag & 1)
    if len(integers) > 1:
        for _ in range(DIFFERENCES):
            integers = np.cumsum(integers, axis=0, dtype=integers.dtype)
    return integers.view(dtype)

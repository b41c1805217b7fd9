"""Products and linear systems of small matrices, with the same bits on every processor.

NumPy's own functions use BLAS and LAPACK, which run different code on different processors.
Matrices are stacked as in NumPy: the last two axes of an array are rows and columns, and the axes
before them broadcast.
"""

import numpy as np

from tetractl.core.poses import Floats


def product(a: Floats, b: Floats) -> Floats:
    """Compute the matrix products of a (..., n, k) and b (..., k, m)."""
    return np.einsum("...nk,...km->...nm", a, b)


def solve(a: Floats, b: Floats) -> Floats:
    """Solve the linear systems a x = b for symmetric, positive definite matrices a.

    Such matrices need no pivoting. For a singular matrix, the result is not finite.

    Args:
        a: Matrices, shape (..., n, n).
        b: Right-hand sides, shape (..., n, m).

    Returns:
        The solutions x, shape (..., n, m).
    """
    row_count = a.shape[-1]
    shape = np.broadcast_shapes(a.shape[:-2], b.shape[:-2])
    coefficients = np.broadcast_to(a, (*shape, row_count, row_count))
    right_sides = np.broadcast_to(b, (*shape, *b.shape[-2:]))
    rows = np.concatenate([coefficients, right_sides], axis=-1)
    for k in range(row_count):
        rows[..., k, :] /= rows[..., k, k, None].copy()
        factors = rows[..., k].copy()
        factors[..., k] = 0.0
        rows -= factors[..., None] * rows[..., k, None, :].copy()
    return rows[..., row_count:]


def inverse(a: Floats) -> Floats:
    """Compute the inverses of symmetric, positive definite matrices (..., n, n).

    For a singular matrix, the result is not finite.
    """
    return solve(a, np.eye(a.shape[-1]))

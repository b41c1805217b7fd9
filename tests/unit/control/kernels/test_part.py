"""Parts of kernels: for kernels only."""

import pytest
from numba import njit

from tetractl.control.kernels.options import ENTRY_STRICT, INLINE_STRICT


@njit(**INLINE_STRICT)
def twice(x):
    return 2 * x


@njit(**ENTRY_STRICT)
def four_times(x):
    return twice(twice(x))


def test_a_kernel_calls_a_part():
    assert four_times(1.5) == 6.0


def test_python_cannot_call_a_part():
    with pytest.raises(TypeError):
        twice(1.5)

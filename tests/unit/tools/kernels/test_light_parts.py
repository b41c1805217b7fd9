"""Parts of kernels get no machine code of their own, and kernels compute what they did."""

import numpy as np
import pytest
from numba import njit

from tetractl.tools.kernels.kernel_options import ENTRY_FAST, INLINE_FAST
from tetractl.tools.kernels.light_parts import TRIED, light

LATEST = ".".join(map(str, TRIED[1]))
UNTRIED = "0.1"  # a version for which parts are compiled as always
VALUES = np.linspace(0.1, 3, 100)
pytestmark = pytest.mark.slow  # compiles


def kernel_and_part(version):
    """A kernel that calls two parts, one of which calls the other; and the other. They are compiled
    as for this version of Numba."""

    @njit(**INLINE_FAST)
    def deep(x, y):
        return np.hypot(x, y) * np.exp(-x) + x * x / y

    @njit(**INLINE_FAST)
    def part(x, y):
        for _ in range(3):
            moved = x + 0.1 * np.sin(y)
            y = deep(y, 1.0 + abs(x))
            x = moved
        return x - y

    @njit(**light(version), **ENTRY_FAST)
    def kernel(values):
        total = 0.0
        for value in values:
            total += part(value, total) / (1.0 + deep(abs(total), value))
        return total

    return kernel, part


def has_machine_code(function):
    (overload,) = function.overloads.values()
    return overload.library._finalized


def test_a_kernel_computes_the_same_bits_and_its_parts_get_no_machine_code():
    kernel, light_part = kernel_and_part(LATEST)
    usual_kernel, usual_part = kernel_and_part(UNTRIED)
    total = kernel(VALUES)
    usual_total = usual_kernel(VALUES)
    assert total.hex() == usual_total.hex()
    assert has_machine_code(kernel)
    assert not has_machine_code(light_part)
    assert has_machine_code(usual_part)


def called_by_another_kernel(part):
    @njit
    def other(x):
        return part(x, 2.0)

    return other(1.0)


@pytest.mark.long
def test_a_part_can_be_called_by_kernels_of_others_too():
    kernel, light_part = kernel_and_part(LATEST)
    usual_kernel, usual_part = kernel_and_part(UNTRIED)
    kernel(VALUES)
    usual_kernel(VALUES)
    expected = called_by_another_kernel(usual_part)
    assert called_by_another_kernel(light_part) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("version", ["0.60.1", "0.69.0", "0.70.0dev0+1", "1.0", "unknown"])
def test_versions_of_numba_that_were_not_tried_compile_as_always(version):
    assert light(version) == {}

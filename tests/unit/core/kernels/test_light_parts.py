"""Parts of kernels get no machine code of their own, and kernels compute what they did."""

import numpy as np
import pytest
from numba import njit

from tetractl.core.kernels.kernel_options import ENTRY_FAST, INLINE_FAST
from tetractl.core.kernels.light_parts import TRIED, light

LATEST = ".".join(map(str, TRIED[1]))
VALUES = np.linspace(0.1, 3, 100)
pytestmark = pytest.mark.slow  # compiles


def kernels(version):
    """A kernel that calls two parts, one of which calls the other."""

    @njit(**INLINE_FAST)
    def deep(x, y):
        return np.hypot(x, y) * np.exp(-x) + x * x / y

    @njit(**INLINE_FAST)
    def part(x, y):
        for _ in range(3):
            x, y = x + 0.1 * np.sin(y), deep(y, 1.0 + abs(x))
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
    (ours, part) = kernels(LATEST)
    (usual, compiled_part) = kernels("0.1")
    assert ours(VALUES).hex() == usual(VALUES).hex()
    assert [
        has_machine_code(compiled_function) for compiled_function in (ours, part, compiled_part)
    ] == [True, False, True]


def _calling(part):
    return lambda x: part(x, 2.0)


def test_a_part_can_be_called_by_kernels_of_others_too():
    printed = []
    for version in (LATEST, "0.1"):
        ours, part = kernels(version)
        ours(VALUES)
        printed.append(njit(_calling(part))(1.0))
    assert printed[0] == pytest.approx(printed[1], rel=1e-12)


@pytest.mark.parametrize("version", ["0.60.1", "0.69.0", "0.70.0dev0+1", "1.0", "unknown"])
def test_versions_of_numba_that_were_not_tried_compile_as_always(version):
    assert light(version) == {}

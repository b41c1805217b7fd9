"""Tests that each parser of outside data keeps its contract; benchmarks/fuzz.py runs longer."""

from itertools import pairwise

import pytest
from testkit.bounded_work import bounded, withstands
from testkit.targets import TARGETS

pytestmark = pytest.mark.long


@pytest.mark.parametrize("name", TARGETS)
def test_anything_may_come(name):
    withstands(TARGETS[name])


LAUGHS = "".join(f"{b}: &{b} [*{a}, *{a}]\n" for a, b in pairwise("abcdefghijklmnopqrstuvwxyz"))


def test_aliases_cannot_multiply():
    with bounded(4_000_000):
        TARGETS["calibration"].run(("a: &a [x, x]\n" + LAUGHS).encode())

"""Whatever comes from outside, its parser keeps its promises; longer in benchmarks/fuzz.py."""

from collections import Counter
from itertools import pairwise

import pytest
from support import hostile
from support.bounded_work import bounded, withstands
from support.targets import TARGETS

pytestmark = pytest.mark.long


@pytest.mark.parametrize("name", TARGETS)
def test_anything_may_come(name):
    withstands(TARGETS[name])


LAUGHS = "".join(f"{b}: &{b} [*{a}, *{a}]\n" for a, b in pairwise("abcdefghijklmnopqrstuvwxyz"))


def test_aliases_cannot_multiply():
    with bounded(4_000_000):
        TARGETS["calibration"].run(("a: &a [x, x]\n" + LAUGHS).encode())


@pytest.mark.parametrize("kind", hostile.KINDS)
def test_hostile_files_are_read_or_told_in_a_line(kind):
    """Twenty thousand of each in benchmarks/hostile.py, with bounds on memory and time."""
    read = Counter()
    for number in range(25):
        command, run = hostile.case(kind, 1, number)
        run()
        read[command] += 1
    assert len(read) > 5

"""A finding on a kind, and the comparisons that give one."""

import random
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import mtrand

SEED = 20
COUNT = 200  # number of random cases per check
NEAR = 1e-6  # relative error up to which two results agree


@dataclass(frozen=True, slots=True)
class Finding:
    """The description of a check, and its error, "" for none."""

    what: str
    problem: str = ""


Findings = Iterator[Finding]


def failed(findings: Findings) -> list[str]:
    """Return the checks with a problem, one line each."""
    return [f"{one.what}: {one.problem}" for one in findings if one.problem]


def near(what: str, ours: Any, theirs: Any, scale: Any, share: float = NEAR) -> Finding:
    """Check that two results differ by at most `share` times `scale`; the error names the case
    that differs most."""
    ours, theirs, scale = np.broadcast_arrays(
        *(np.asarray(v, float) for v in (ours, theirs, scale))
    )
    off = np.abs(ours - theirs) / np.maximum(scale, 1e-300)
    worst = int(np.argmax(np.where(np.isfinite(off), off, np.inf)))
    if off.ravel()[worst] <= share:
        return Finding(what)
    values = f"{ours.ravel()[worst]:.9g} and {theirs.ravel()[worst]:.9g}"
    return Finding(what, f"{values} in case {worst} of {off.size}")


def true(what: str, good: Any, problem: str = "not so") -> Finding:
    """Check that all cases are good; the error names the first that is not."""
    bad = np.flatnonzero(~np.asarray(good, bool).ravel())
    return Finding(what, f"{problem} in case {bad[0]} of {np.size(good)}" if bad.size else "")


def same(what: str, one: Any, other: Any) -> Finding:
    """Check that two sequences of arrays or numbers have the same bits."""
    alike = all(np.array_equal(a, b, equal_nan=True) for a, b in zip(one, other, strict=True))
    return Finding(what, "" if alike else "differs bit for bit")


@contextmanager
def random_watched() -> Iterator[list[str]]:
    """Seed the global random generators; after the `with` block, the list names those used."""
    random.seed()
    mtrand.set_bit_generator(np.random.MT19937())
    used = list[str]()
    known, ours = random.getstate(), repr(mtrand.get_bit_generator().state)
    yield used
    used += ["random"] * (random.getstate() != known)
    used += ["numpy.random"] * (repr(mtrand.get_bit_generator().state) != ours)

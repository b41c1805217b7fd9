"""What a check of a plug-in finds: its name and its error; and the comparisons that checks make."""

import random
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import mtrand

SEED = 20
"""Seed of the checks, so that findings repeat."""
COUNT = 200
"""Number of random cases in a check."""
NEAR = 1e-6
"""Relative error up to which two results agree."""
TINY = 1e-300
"""Least scale that a difference is divided by."""


@dataclass(frozen=True, slots=True)
class Finding:
    """The description of a check, and its error, "" for none."""

    what: str
    problem: str = ""


Findings = Iterator[Finding]


def failed(findings: Findings) -> list[str]:
    """Return the checks with a problem, one line each."""
    return [f"{finding.what}: {finding.problem}" for finding in findings if finding.problem]


def near(what: str, ours: Any, theirs: Any, scale: Any, share: float = NEAR) -> Finding:
    """Check that two results differ by at most `share` times `scale`; the error names the case
    that differs most."""
    arrays = [np.asarray(value, float) for value in (ours, theirs, scale)]
    ours, theirs, scale = np.broadcast_arrays(*arrays)
    off = np.abs(ours - theirs) / np.maximum(scale, TINY)
    comparable_off = np.where(np.isfinite(off), off, np.inf)
    worst = int(np.argmax(comparable_off))
    if off.ravel()[worst] <= share:
        return Finding(what)
    values = f"{ours.ravel()[worst]:.9g} and {theirs.ravel()[worst]:.9g}"
    return Finding(what, f"{values} in case {worst} of {off.size}")


def true(what: str, good: Any, problem: str = "not so") -> Finding:
    """Check that all cases are good; the error names the first that is not."""
    cases = np.asarray(good, bool).ravel()
    bad = np.flatnonzero(~cases)
    if not bad.size:
        return Finding(what)
    return Finding(what, f"{problem} in case {bad[0]} of {cases.size}")


def same(what: str, ours: Any, theirs: Any) -> Finding:
    """Check that two sequences of arrays or numbers have the same bits."""
    pairs = zip(ours, theirs, strict=True)
    alike = all(np.array_equal(our, their, equal_nan=True) for our, their in pairs)
    return Finding(what, "" if alike else "differs bit for bit")


@contextmanager
def random_watched() -> Iterator[list[str]]:
    """Seed the global random generators; after the `with` block, the list names those used."""
    random.seed()
    mtrand.set_bit_generator(np.random.MT19937())
    used = list[str]()
    before = random.getstate()
    before_of_numpy = _numpy_state()
    yield used
    if random.getstate() != before:
        used.append("random")
    if _numpy_state() != before_of_numpy:
        used.append("numpy.random")


def _numpy_state() -> str:
    """Return the state of NumPy's global generator as text, which can be compared."""
    return repr(mtrand.get_bit_generator().state)

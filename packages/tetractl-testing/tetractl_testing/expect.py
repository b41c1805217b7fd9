"""Comparisons that the checks of plug-ins use to state expectations.

An expectation that fails raises AssertionError, as in any test with pytest. Within `findings_of`,
all expectations are listed instead, whether they hold or fail.
"""

import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from traceback import extract_tb
from typing import Any

import numpy as np
from numpy.random import mtrand

from tetractl.core.errors import UsageError

SEED = 20
"""Seed of the checks, so that findings repeat."""
COUNT = 200
"""Number of random cases in a check."""
NEAR = 1e-6
"""Maximum relative error of two results that agree."""
TINY = 1e-300
"""Minimum scale that a difference is divided by."""


@dataclass(frozen=True, slots=True)
class Finding:
    """An expectation of a check, and its result.

    Attributes:
        what: What is expected.
        problem: What is wrong. "" if the expectation holds.
    """

    what: str
    problem: str = ""


_FINDINGS: ContextVar[list[Finding] | None] = ContextVar("findings", default=None)
"""Where a check lists what it expects; None if it raises what does not hold."""


def expect(what: str, problem: str = "") -> None:
    """Record or raise the result of an expectation.

    Args:
        what: What is expected.
        problem: What is wrong. "" if the expectation holds.

    Raises:
        AssertionError: If there is a problem, outside of `findings_of`.
    """
    findings = _FINDINGS.get()
    if findings is not None:
        findings.append(Finding(what, problem))
    elif problem:
        raise AssertionError(f"{what}: {problem}")


def findings_of(check: Callable[[], object]) -> list[Finding]:
    """Run a check, and return the results of all its expectations.

    If the code under test raises an exception, the check ends, and the exception is the last
    finding.
    """
    findings: list[Finding] = []
    token = _FINDINGS.set(findings)
    try:
        check()
    except UsageError:
        raise
    except Exception as error:
        line = extract_tb(error.__traceback__)[-1]
        problem = f"{line.filename}:{line.lineno}: {type(error).__name__}: {error}"
        findings.append(Finding("runs", problem))
    finally:
        _FINDINGS.reset(token)
    return findings


def near(what: str, ours: Any, theirs: Any, scale: Any, tolerance: float = NEAR) -> None:
    """Expect that two results are nearly equal. The problem names the case that differs most.

    Args:
        what: What is compared.
        ours: The result of the code under test.
        theirs: The expected result.
        scale: Scale of the difference.
        tolerance: Maximum difference, as a fraction of `scale`.
    """
    arrays = [np.asarray(value, float) for value in (ours, theirs, scale)]
    ours, theirs, scale = np.broadcast_arrays(*arrays)
    off = np.abs(ours - theirs) / np.maximum(scale, TINY)
    comparable_off = np.where(np.isfinite(off), off, np.inf)
    worst = int(np.argmax(comparable_off))
    problem = ""
    if comparable_off.ravel()[worst] > tolerance:
        values = f"{ours.ravel()[worst]:.9g} and {theirs.ravel()[worst]:.9g}"
        problem = f"{values} in case {worst} of {off.size}"
    expect(what, problem)


def true(what: str, good: Any, problem: str = "not so") -> None:
    """Expect that all cases are good. The problem names the first that is not.

    Args:
        what: What is checked.
        good: Whether each case is good.
        problem: The problem of a case that is not.
    """
    cases = np.asarray(good, bool).ravel()
    bad = np.flatnonzero(~cases)
    expect(what, f"{problem} in case {bad[0]} of {cases.size}" if bad.size else "")


def same(what: str, ours: Any, theirs: Any) -> None:
    """Expect that two sequences of arrays or numbers have the same bits.

    Args:
        what: What is compared.
        ours: The result of the code under test.
        theirs: The expected result.
    """
    pairs = zip(ours, theirs, strict=True)
    alike = all(np.array_equal(our, their, equal_nan=True) for our, their in pairs)
    expect(what, "" if alike else "differs bit for bit")


@contextmanager
def random_watched() -> Iterator[list[str]]:
    """Watch the global random generators in a `with` block, and list the ones that were used.

    The list is filled when the block ends. Both generators are given a new state at its start.
    """
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
    """Convert the state of NumPy's global generator to a text that can be compared."""
    return repr(mtrand.get_bit_generator().state)

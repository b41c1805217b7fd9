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
TOLERANCE = 1e-6
"""Maximum relative error of two results that agree."""
SCALE_MIN = 1e-300
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
"""The findings of the running check. None if a failed expectation raises AssertionError."""


def expect(expectation: str, problem: str = "") -> None:
    """Record or raise the result of an expectation.

    Args:
        expectation: What is expected.
        problem: What is wrong. "" if the expectation holds.

    Raises:
        AssertionError: If there is a problem, outside of `findings_of`.
    """
    findings = _FINDINGS.get()
    if findings is not None:
        findings.append(Finding(expectation, problem))
    elif problem:
        raise AssertionError(f"{expectation}: {problem}")


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


def expect_near(
    expectation: str, actual: Any, expected: Any, scale: Any, tolerance: float = TOLERANCE
) -> None:
    """Expect that two results are nearly equal. The problem names the case that differs most.

    Args:
        expectation: What is compared.
        actual: The result of the code under test.
        expected: The expected result.
        scale: Scale of the difference.
        tolerance: Maximum difference, as a fraction of `scale`.
    """
    arrays = [np.asarray(value, float) for value in (actual, expected, scale)]
    actual, expected, scale = np.broadcast_arrays(*arrays)
    errors = np.abs(actual - expected) / np.maximum(scale, SCALE_MIN)
    finite_errors = np.where(np.isfinite(errors), errors, np.inf)
    worst_case = int(np.argmax(finite_errors))
    problem = ""
    if finite_errors.ravel()[worst_case] > tolerance:
        values = f"{actual.ravel()[worst_case]:.9g} and {expected.ravel()[worst_case]:.9g}"
        problem = f"{values} in case {worst_case} of {errors.size}"
    expect(expectation, problem)


def expect_true(expectation: str, conditions: Any, problem: str = "not so") -> None:
    """Expect that a condition holds in all cases. The problem names the first case that fails.

    Args:
        expectation: What is checked.
        conditions: Whether the condition holds in each case.
        problem: Description of a case that fails.
    """
    holds_in_case = np.asarray(conditions, bool).ravel()
    failing = np.flatnonzero(~holds_in_case)
    expect(
        expectation,
        f"{problem} in case {failing[0]} of {holds_in_case.size}" if failing.size else "",
    )


def expect_same(expectation: str, actual: Any, expected: Any) -> None:
    """Expect that two sequences of arrays or numbers have the same bits.

    Args:
        expectation: What is compared.
        actual: The result of the code under test.
        expected: The expected result.
    """
    pairs = zip(actual, expected, strict=True)
    is_equal = all(
        np.array_equal(actual_item, expected_item, equal_nan=True)
        for actual_item, expected_item in pairs
    )
    expect(expectation, "" if is_equal else "differs bit for bit")


@contextmanager
def random_watched() -> Iterator[list[str]]:
    """Watch the global random generators in a `with` block, and list the ones that were used.

    The list is filled when the block ends. Both generators are given a new state at its start.
    """
    random.seed()
    mtrand.set_bit_generator(np.random.MT19937())
    generators_used = list[str]()
    state = random.getstate()
    numpy_state = _numpy_state()
    yield generators_used
    if random.getstate() != state:
        generators_used.append("random")
    if _numpy_state() != numpy_state:
        generators_used.append("numpy.random")


def _numpy_state() -> str:
    """Convert the state of NumPy's global generator to a text that can be compared."""
    return repr(mtrand.get_bit_generator().state)

"""Tests of the package for IPOPT, with a fake instead of CasADi."""

import sys

import pytest
from solverbench.problems import printed
from testkit.paths import ROOT

from tetractl.core.plan import Limits, StopReason

LENGTH = 3  # signals, too few to reach a target


class EchoedGuess:
    """A programme that returns each guess as its solution."""

    iterations = 75

    def solve(self, problem, guess):
        return guess


@pytest.fixture
def package(monkeypatch):
    """The module of the package, whose programmes are played."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks/tetractl-ipopt"))
    import tetractl_ipopt

    monkeypatch.setattr(
        tetractl_ipopt, "shooting_programme", lambda *sizes, **options: EchoedGuess()
    )
    yield tetractl_ipopt
    del sys.modules["tetractl_ipopt"]


def test_a_search_solves_until_its_iterations_are_used(package):
    """Regression: a search asked a method that the progress of searches does not have any more."""
    ipopt = package.Ipopt(type="ipopt")
    search = ipopt.search(printed(), LENGTH, None, 0, Limits())
    assert 2 * EchoedGuess.iterations == package.ITERATIONS_ALL
    assert search.evaluations == 3  # the first start, and two solutions
    assert search.stopped is StopReason.ITERATIONS


@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        (Limits(evaluations=1), StopReason.EVALUATIONS),
        (Limits(expired=lambda spent: True), StopReason.DEADLINE),
    ],
)
def test_a_search_heeds_its_limits(package, limits, reason):
    search = package.Ipopt(type="ipopt").search(printed(), LENGTH, None, 0, limits)
    assert search.evaluations == 1
    assert search.stopped is reason


def test_a_search_ends_at_its_tolerance(package):
    ipopt = package.Ipopt(type="ipopt", tolerance=1e9)
    search = ipopt.search(printed(), LENGTH, None, 0, Limits())
    assert search.evaluations == 1
    assert search.stopped is StopReason.TARGET

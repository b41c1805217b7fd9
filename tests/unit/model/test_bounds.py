"""Tests of lower bounds of the total error, against plans from a good optimiser."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from hypothesis import given
from hypothesis import strategies as st
from testkit.bounded import best_plan, seconds_of, spec

from tetractl.model.bounds import compute_drift_bounds, compute_min_total_error

pytestmark = pytest.mark.slow


def most_drift(a_1, a_2, turned, seconds):
    """The bound of `drift`, of two robots alone."""
    return compute_drift_bounds(np.asarray(a_1), np.asarray(a_2), np.asarray(turned), seconds)


def widest_gap(a_1, a_2, turned, seconds):
    """|w_1 - w_2| where u makes the headings part as fast as they can, and keeps them apart."""
    steps = 4000
    dt = seconds / steps
    half = turned / 2
    first = -half
    second = half
    across = up = 0.0
    for _ in range(steps):
        delta = second - first
        # delta' = (a_2 - a_1) sin m cos(delta/2) - (a_1 + a_2) cos m sin(delta/2), greatest at:
        m = math.atan2((a_2 - a_1) * math.cos(delta / 2), -(a_1 + a_2) * math.sin(delta / 2))
        u = (first + second) / 2 + m
        if delta < math.pi:
            first += dt * a_1 * math.sin(u - first)
            second += dt * a_2 * math.sin(u - second)
        across += dt * (math.cos(second) - math.cos(first))
        up += dt * (math.sin(second) - math.sin(first))
    return math.hypot(across, up)


@given(
    a_1=st.floats(0.5, 8),
    share=st.floats(0.5, 1),
    turned=st.floats(0, 3),
    seconds=st.floats(0.01, 3),
)
def test_no_direction_drives_two_robots_further_apart(a_1, share, turned, seconds):
    a_2 = a_1 * share
    most = most_drift(a_1, a_2, turned, seconds)
    assert widest_gap(a_1, a_2, turned, seconds) <= most * (1 + 1e-3) + 1e-9
    assert most <= 2 * seconds * (1 + 1e-12)


@pytest.mark.parametrize("turned", [0.0, 0.1])
@pytest.mark.parametrize("a_2", [3.0, 3.99])
def test_for_a_short_time_the_limit_is_nearly_reached(a_2, turned):
    most = most_drift(4.0, a_2, turned, 0.2)
    assert widest_gap(4.0, a_2, turned, 0.2) > 0.9 * most > 0


@pytest.mark.parametrize("motion", ["exact", "euler"])
@pytest.mark.parametrize("seed", range(12))
def test_no_plan_undercuts_the_bound(seed, motion):
    """Random robots, some alike, some nearly so, with too little time or just enough."""
    rng = np.random.default_rng(seed)
    robots = int(rng.integers(1, 5))
    signals = int(rng.integers(4, 14))
    experiment = spec(rng, robots=robots, signals=signals, motion=motion)
    least = compute_min_total_error(experiment.setup, seconds_of(experiment))
    plan = best_plan(experiment)
    assert plan >= least - 1e-6
    setup = experiment.setup
    headings = np.full_like(setup.a, setup.starts.heading[0])
    as_first = replace(
        setup, a=np.full_like(setup.a, setup.a[0]), starts=replace(setup.starts, heading=headings)
    )
    together = compute_min_total_error(as_first, seconds_of(experiment))
    assert together >= least - 1e-6


def test_three_robots_alike_are_bounded_by_their_pairs_together():
    """Targets at the corners of a triangle of side 300, as seen from the starts: half its girth."""
    rng = np.random.default_rng(1)
    setup = spec(rng, robots=3, signals=30, kind="equal").setup
    corners = 300 * np.array([[0, 0], [1, 0], [0.5, math.sqrt(3) / 2]])
    setup = replace(setup, speed=np.full(3, 100.0), targets=setup.starts.xy + corners)
    assert compute_min_total_error(setup, 60.0) == pytest.approx(450)


def test_if_the_solver_fails_the_best_single_pair_still_bounds(monkeypatch):
    rng = np.random.default_rng(1)
    setup = spec(rng, robots=3, signals=30, kind="equal").setup
    corners = 300 * np.array([[0, 0], [1, 0], [0.25, 0]])
    setup = replace(setup, speed=np.full(3, 100.0), targets=setup.starts.xy + corners)
    assert compute_min_total_error(setup, 60.0) == pytest.approx(300)
    solve = scipy.optimize.linprog

    def fails(*args, **options):
        solved = solve(*args, **options)
        solved.success = False
        return solved

    monkeypatch.setattr(scipy.optimize, "linprog", fails)
    assert compute_min_total_error(setup, 60.0) == pytest.approx(300)

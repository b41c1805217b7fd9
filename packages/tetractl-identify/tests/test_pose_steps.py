"""Tests of steps between poses on arcs, and of regressions by least absolute deviations."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog
from tetractl_identify.pose_steps import PoseSteps, fit_robust_gains


@given(
    heading=st.floats(-math.pi, math.pi),
    turned=st.floats(-3, 3),
    way=st.floats(-50, 50),
    aside=st.floats(-5, 5),
)
def test_a_step_along_an_arc_is_its_length_and_its_turn(heading, turned, way, aside):
    """A robot that turns evenly while it drives forwards and slips aside evenly."""
    moments = (np.arange(4000) + 0.5) / 4000
    course = heading + turned * moments
    moved = np.mean(complex(way, aside) * np.exp(1j * course))
    poses = np.array([[3.0, 4.0, heading], [3.0 + moved.real, 4.0 + moved.imag, heading + turned]])
    steps = PoseSteps.from_poses(np.array([2.0, 2.5]), poses)
    assert steps.displacement[0] == pytest.approx(complex(way, aside), abs=1e-4)
    assert steps.turn_rad[0] == pytest.approx(turned, abs=1e-9)
    assert steps.duration_s.tolist() == [0.5]


def test_a_turn_across_the_half_turn_is_the_short_one():
    poses = np.array([[0.0, 0.0, 3.1], [1.0, 0.0, -3.1]])
    steps = PoseSteps.from_poses(np.array([0.0, 1.0]), poses)
    assert steps.turn_rad[0] == pytest.approx(math.tau - 6.2)


def test_steps_are_joined_and_selected_in_their_order():
    poses = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]])
    one = PoseSteps.from_poses(np.array([0.0, 1.0, 3.0]), poses)
    both = PoseSteps.concatenate([one, one])
    assert both.displacement.real.tolist() == [1.0, 2.0, 1.0, 2.0]
    selected = both.select(np.array([False, True, True, False]))
    assert selected.displacement.real.tolist() == [2.0, 1.0]
    assert selected.duration_s.tolist() == [2.0, 1.0]


@given(st.integers(0, 1000))
def test_robust_gains_have_the_least_sum_of_absolute_deviations(seed):
    rng = np.random.default_rng(seed)
    causes = rng.normal(size=(40, 2)) * [1.0, 300.0]
    measured = causes @ [1.5, -0.02] + rng.normal(0, 0.1, 40)
    measured[:6] += 30.0  # outliers
    count = len(measured)
    # min sum(t) with -t <= measured - causes g <= t, as a linear program
    identity = np.eye(count)
    rows = np.block([[causes, -identity], [-causes, -identity]])
    free = [(None, None)] * 2 + [(0, None)] * count
    cost = np.concatenate([np.zeros(2), np.ones(count)])
    best = linprog(cost, rows, np.concatenate([measured, -measured]), bounds=free)
    gains = fit_robust_gains(measured, causes)
    assert np.abs(measured - causes @ gains).sum() <= best.fun * 1.01
    assert gains == pytest.approx([1.5, -0.02], abs=0.1)

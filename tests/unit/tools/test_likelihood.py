"""Tests of Newton steps and derivatives of likelihoods, on functions with known ones."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.tools.likelihood import LOG_LIKELIHOOD_MIN, STEP_MAX, derivatives, newton_step

CURVATURE = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, -0.7], [0.5, -0.7, 2.0]])
NO_PRIOR = 1e6


def parabola(best, curvature=CURVATURE, scale=1.0):
    """The log-likelihood of each variant (N, V, P), greatest at `best` (N, P)."""

    def likelihood(variants):
        off = variants - np.asarray(best, dtype=float)[:, None]
        return -0.5 * scale * np.einsum("nvi,ij,nvj->nv", off, curvature, off)

    return likelihood


@given(st.lists(st.floats(-0.9, 0.9), min_size=3, max_size=3))
def test_a_step_leads_to_the_top_of_a_parabola_within_reach(best):
    found, std = newton_step(parabola([best]), np.zeros((1, 3)), NO_PRIOR)
    assert found[0] == pytest.approx(best, abs=1e-6)
    assert std[0] == pytest.approx(np.sqrt(np.diag(np.linalg.inv(CURVATURE))), rel=1e-4)


def test_each_row_has_its_own_top():
    best = [[0.1, 0.2, 0.3], [-0.4, 0.0, 0.5]]
    found, std = newton_step(parabola(best), np.zeros((2, 3)), NO_PRIOR)
    assert found == pytest.approx(np.array(best), abs=1e-6)
    assert std.shape == (2, 3)


def test_a_step_begins_at_the_parameters():
    start = np.array([[1.5, -2.0, 0.5]])
    found, _ = newton_step(parabola([[1.2, -1.9, 0.8]]), start, NO_PRIOR)
    assert found[0] == pytest.approx([1.2, -1.9, 0.8], abs=1e-6)


def test_a_step_is_limited():
    far = [[50.0, -50.0, 0.0]]
    found, _ = newton_step(parabola(far, np.eye(3)), np.zeros((1, 3)), NO_PRIOR)
    assert found[0] == pytest.approx([STEP_MAX, -STEP_MAX, 0.0], abs=1e-6)


def test_a_step_never_leads_to_a_worse_place():
    """Where the curve is hollow or not a parabola, only a part of the step is taken, or none."""

    def double(variants):
        return -np.square(np.square(variants) - 0.25).sum(axis=2) * 8

    for start in (0.02, 0.3, -0.45, 0.5, 2.0):
        at = np.full((1, 2), start)
        found, _ = newton_step(double, at, NO_PRIOR)
        assert double(found[:, None])[0, 0] >= double(at[:, None])[0, 0]
    hollow, _ = newton_step(double, np.full((1, 2), 0.1), NO_PRIOR)
    assert (hollow > 0.1).all()  # uphill, away from 0


def test_the_prior_pulls_towards_0_by_its_width():
    likelihood = parabola([[0.8]], np.array([[1.0]]))
    found, std = newton_step(likelihood, np.zeros((1, 1)), 1.0)
    assert found[0, 0] == pytest.approx(0.4, abs=1e-6)  # as precise as the likelihood
    assert std[0, 0] == pytest.approx(np.sqrt(0.5), rel=1e-6)
    found, _ = newton_step(likelihood, np.zeros((1, 1)), 3.0)
    assert found[0, 0] == pytest.approx(0.72, abs=1e-6)


def test_a_flat_likelihood_leaves_the_prior():
    found, std = newton_step(lambda v: np.zeros(v.shape[:2]), np.zeros((1, 2)), 2.0)
    assert found[0] == pytest.approx([0, 0])
    assert std[0] == pytest.approx([2.0, 2.0])


def test_variants_without_a_likelihood_are_not_chosen():
    def bounded(variants):
        values = parabola([[0.9, 0.0]], np.eye(2))(variants)
        return np.where(variants[..., 0] > 0.5, np.nan, values)

    found, std = newton_step(bounded, np.zeros((1, 2)), NO_PRIOR)
    assert 0 < found[0, 0] <= 0.5
    assert np.isfinite(std).all()
    assert LOG_LIKELIHOOD_MIN < -1e9


def test_derivatives_of_a_parabola_are_its_slope_and_negative_curvature():
    point = np.array([0.3, -0.2, 0.5])

    def score(changes):
        at = point + changes[0]
        return (-0.5 * np.einsum("vi,ij,vj->v", at, CURVATURE, at))[None]

    slope, curvature = derivatives(score, 3)
    assert slope[0] == pytest.approx(-CURVATURE @ point)
    assert curvature[0] == pytest.approx(CURVATURE)


def test_derivatives_of_several_scores_are_separate():
    def score(changes):
        x, y = changes[0].T
        return np.stack([3 * x - 2 * y, x * y, -(x**2)])

    slope, curvature = derivatives(score, 2)
    assert slope == pytest.approx(np.array([[3, -2], [0, 0], [0, 0]]), abs=1e-9)
    assert curvature[0] == pytest.approx(np.zeros((2, 2)), abs=1e-9)
    assert curvature[1] == pytest.approx(np.array([[0, -1], [-1, 0]]))
    assert curvature[2] == pytest.approx(np.array([[2, 0], [0, 0]]), abs=1e-9)

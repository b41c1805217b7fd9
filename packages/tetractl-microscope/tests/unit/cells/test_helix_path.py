"""Tests of the filter over a whole path: likelihoods, lost cells and images without a blob."""

import numpy as np
import pytest
from testkit.microscope import helix_steps as oracle
from tetractl_microscope.cells.helix import new_cell
from tetractl_microscope.cells.kernels.helix_path import (
    DISTANT_COUNT,
    DISTANT_SQUARED,
    log_likelihoods_of,
    smooth,
)
from tetractl_microscope.cells.kernels.helix_steps import (
    HEADING,
    PATH_LENGTH,
    RATE,
    SPEED,
    SPEED_MIN,
    STATE_SIZE,
    A,
    C,
    X,
    Y,
)
from tetractl_microscope.organisms import TETRAHYMENA

FRAME_S = 1 / 30
FIELD = 0.6, 0.8
OTHER = -0.8, 0.6


def start():
    mean, covariance, model = new_cell(TETRAHYMENA, field_known=True)
    mean[[X, Y, HEADING, SPEED, A, C]] = 10.0, 20.0, 0.3, 320.0, 3.5, 5.0
    return mean, covariance, model


def swum(count, seed=1):
    """Measured bodies of a cell that moves as the model says, and the pieces of the field."""
    m, p, model = start()
    pieces = [(FRAME_S, *(FIELD if k < count // 2 else OTHER)) for k in range(count - 1)]
    bodies = [oracle.body(m, model[SPEED_MIN])]
    for seconds, *field in pieces:
        m = oracle.moved(m, 0 * p, seconds, field, model[SPEED_MIN])
        bodies.append(oracle.body(m, model[SPEED_MIN]))
    noise = np.random.default_rng(seed).normal(0, 1, (count, 3)) * (0.5, 0.5, 0.03)
    return np.array(bodies) + noise, np.tile((0.5, 0.5, 0.03), (count, 1)), pieces


def reference(measured, deviation, pieces, mean, covariance, model):
    """The log-likelihood and the last state of the filter with whole matrices."""
    m, p = mean.copy(), covariance.copy()
    total = 0.0
    odd = 0
    for k, values in enumerate(measured):
        if k:
            if k > 1 and pieces[k - 1][1:] != pieces[k - 2][1:]:
                change = pieces[k - 2][1:], pieces[k - 1][1:], model[SPEED_MIN]
                f = oracle.slopes(lambda at, change=change: oracle.switched(at, *change), m)
                m, p = oracle.switched(m, *change), f @ p @ f.T
            seconds, *field = pieces[k - 1]
            m, p, _ = oracle.move(m, p, model, False, seconds, field)
        if not np.isfinite(values[0]):
            continue
        m, p, likelihood, distance = oracle.correct(m, p, model, values, deviation[k])
        total += likelihood
        odd = odd + 1 if distance > DISTANT_SQUARED else 0
        if odd == DISTANT_COUNT:
            new = np.arange(RATE)
            p[new, new] += np.diagonal(covariance)[:RATE]
            p[PATH_LENGTH, PATH_LENGTH] += covariance[0, 0]
            odd = 0
    return total, m, p


def run(measured, deviation, pieces, means, covariance, models):
    first = np.maximum(np.arange(len(measured) + 1) - 1, 0)
    totals = np.empty(len(means))
    after = means.copy()
    log_likelihoods_of(
        after, covariance, models, measured, deviation, np.array(pieces), first, totals
    )
    return totals, after


def test_the_likelihood_of_each_variant_is_that_of_whole_matrices():
    measured, deviation, pieces = swum(16)
    mean, covariance, model = start()
    means = np.array([mean, mean, mean])
    means[1, HEADING] += 0.4
    means[2, A] = 1.0
    models = np.array([model, model, model])
    models[2, A] *= 3
    kept = means.copy()
    totals, after = run(measured, deviation, pieces, means, covariance, models)
    assert (means == kept).all()
    for v in range(3):
        total, last, _ = reference(measured, deviation, pieces, means[v], covariance, models[v])
        assert totals[v] == pytest.approx(total, rel=1e-5)
        assert after[v] == pytest.approx(last, rel=1e-4, abs=1e-4)
    assert totals[0] > totals[1]


def test_images_without_a_blob_count_only_by_their_time():
    measured, deviation, pieces = swum(14)
    measured[[0, 5, 6, 13]] = np.nan
    mean, covariance, model = start()
    totals, after = run(measured, deviation, pieces, mean[None], covariance, model[None])
    total, last, _ = reference(measured, deviation, pieces, mean, covariance, model)
    assert totals[0] == pytest.approx(total, rel=1e-5)
    assert after[0] == pytest.approx(last, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("outliers", [DISTANT_COUNT - 1, DISTANT_COUNT, DISTANT_COUNT + 1])
def test_a_cell_that_is_far_off_in_three_images_is_searched_anew(outliers):
    measured, deviation, pieces = swum(16)
    measured[8 : 8 + outliers, :2] += 60.0
    mean, covariance, model = start()
    totals, after = run(measured, deviation, pieces, mean[None], covariance, model[None])
    total, last, covariance_at_end = reference(measured, deviation, pieces, mean, covariance, model)
    assert totals[0] == pytest.approx(total, rel=1e-4)
    assert after[0, :2] == pytest.approx(last[:2], rel=1e-3)
    states = np.empty((16, STATE_SIZE))
    bodies = np.empty((16, 3))
    m = mean.copy()
    first = np.maximum(np.arange(17) - 1, 0)
    p = smooth(m, covariance, model, measured, deviation, np.array(pieces), first, states, bodies)
    assert m == pytest.approx(after[0])
    assert p == pytest.approx(covariance_at_end, rel=1e-2, abs=1e-2)
    assert states[-1] == pytest.approx(m)


def test_two_outliers_apart_do_not_make_a_cell_uncertain():
    measured, deviation, pieces = swum(16)
    measured[[6, 8, 10], :2] += 60.0
    mean, covariance, model = start()
    totals, _ = run(measured, deviation, pieces, mean[None], covariance, model[None])
    assert totals[0] == pytest.approx(
        reference(measured, deviation, pieces, mean, covariance, model)[0], rel=1e-4
    )


def test_a_cell_that_is_turned_around_on_the_way_is_smoothed_forwards_and_backwards():
    """It starts with the wrong end in front. After some images it is on its blobs."""
    measured, deviation, pieces = swum(20)
    mean, covariance, model = start()
    mean[HEADING] += np.pi
    mean[C] *= -1
    states = np.empty((20, STATE_SIZE))
    bodies = np.empty((20, 3))
    first = np.maximum(np.arange(21) - 1, 0)
    m = mean.copy()
    smooth(m, covariance, model, measured, deviation, np.array(pieces), first, states, bodies)
    assert m[SPEED] > 200
    assert np.linalg.norm(bodies[4:, :2] - measured[4:, :2], axis=1).max() < 6.0

"""Tests of products and linear systems of small matrices."""

import numpy as np

from tetractl.core.linear import inverse, product, solve

RANDOM = np.random.default_rng(3)
FACTORS = RANDOM.normal(size=(5, 4, 4))
POSITIVE = FACTORS @ FACTORS.swapaxes(1, 2) + np.eye(4)


def test_products_are_those_of_numpy():
    columns = RANDOM.normal(size=(4, 3))
    np.testing.assert_allclose(product(FACTORS, columns), FACTORS @ columns, rtol=1e-12, atol=1e-12)


def test_solutions_and_inverses_are_those_of_numpy():
    sides = RANDOM.normal(size=(5, 4, 2))
    np.testing.assert_allclose(solve(POSITIVE, sides), np.linalg.solve(POSITIVE, sides), rtol=1e-10)
    np.testing.assert_allclose(inverse(POSITIVE), np.linalg.inv(POSITIVE), rtol=1e-10)
    one = POSITIVE[0]
    np.testing.assert_allclose(solve(one, sides), np.linalg.solve(one, sides), rtol=1e-10)


def test_a_singular_matrix_is_no_error():
    with np.errstate(all="ignore"):
        assert not np.isfinite(solve(np.zeros((2, 2)), np.ones((2, 1)))).any()

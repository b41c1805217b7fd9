"""The mathematics of benchmarks/postmortem.py, on functions whose shares are known."""

import numpy as np
import postmortem
import pytest

CAUSES = [cause.name for cause in postmortem.CAUSES]
LOSS, LAG, ONCE = (CAUSES.index(name) for name in ("loss", "lag", "once"))


def drawn(count, noise):
    rng = np.random.default_rng(1)
    worlds = postmortem.draw(rng, count)
    mean = 600 + 30 * worlds[:, LOSS] + 60 * worlds[:, LAG] * worlds[:, ONCE]
    return worlds, mean, mean + noise * rng.standard_normal(count)


def test_shares_are_those_of_the_function():
    """Variances: 30^2/3 = 300 of loss alone, 60^2/3 = 1200 of lag and once together."""
    worlds, _, errors = drawn(4000, 40.0)
    terms = postmortem.BASIS.of(worlds)
    coefs = postmortem.coefficients(terms, errors)
    noise = postmortem.chance(terms, errors, coefs)
    first, total, shapley = postmortem.shares(coefs, noise)
    assert shapley[[LOSS, LAG, ONCE]] == pytest.approx([0.2, 0.4, 0.4], abs=0.06)
    assert first[[LOSS, LAG, ONCE]] == pytest.approx([0.2, 0, 0], abs=0.06)
    assert total[[LOSS, LAG, ONCE]] == pytest.approx([0.2, 0.8, 0.8], abs=0.08)
    assert shapley.sum() == pytest.approx(1)
    others = np.delete(shapley, [LOSS, LAG, ONCE])
    assert np.abs(others).max() < 0.05
    assert abs(others.mean()) < 0.01  # what chance adds was taken away


def test_terms_are_orthonormal_under_the_ranges():
    terms = postmortem.BASIS.of(postmortem.draw(np.random.default_rng(2), 50_000))
    gram = terms.T @ terms / len(terms)
    assert np.abs(gram - np.eye(len(gram))).max() < 0.06


def test_mean_and_deviation_of_a_world_are_found_and_the_posterior_agrees_with_the_published():
    worlds, mean, errors = drawn(6000, 225.0)
    fit = postmortem.Fit.of(worlds, errors)
    found, std = fit.predict(worlds)
    assert np.std(found - mean) < 40
    assert std.mean() == pytest.approx(225, rel=0.05)
    accepted, predicted = postmortem.posterior(fit, np.random.default_rng(3))
    assert len(accepted) > 1000
    assert predicted[:, 0].mean() == pytest.approx(648.6, abs=40)
    product = accepted[:, LAG] * accepted[:, ONCE]
    assert product.mean() > 0.1  # either alone says nothing
    assert abs(accepted[:, LAG].mean()) < 0.1


def test_a_world_is_a_spec_and_a_trial_repeats_itself(monkeypatch):
    spec = postmortem.load_spec(postmortem.SPEC, ["controller.time_limit=0.2"])
    (world,) = postmortem.draw(np.random.default_rng(4), 1)
    one, two = (postmortem.run(spec, world, 5) for _ in range(2))
    assert one.total_error == two.total_error
    v = postmortem.values(world)
    assert postmortem.plant(v).drive.lag == v["lag"]
    for cause in postmortem.CAUSES:
        assert cause.low <= v[cause.name] <= cause.high

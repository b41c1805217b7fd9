"""A plan linearised, against the ends of changed plans."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.problems import problem, world

from tetractl.analysis.closed_loop import linearise
from tetractl.control.cost import predict
from tetractl.core.poses import Poses

STEP = 1e-6
MOTIONS = ("euler", "arc", "exact")


def case(seed, motion, length=9):
    posed = replace(problem(world(seed, model=motion)), first_period=0.13)
    return posed, np.random.default_rng(seed).uniform(-3, 3, length)


def ends(posed, signals):
    return predict(posed, signals)[-1, :, :2]


@given(st.integers(0, 10_000), st.sampled_from(MOTIONS))
def test_by_signal(seed, motion):
    posed, signals = case(seed, motion)
    ahead, behind = (
        np.array([ends(posed, signals + way * one).ravel() for one in STEP * np.eye(len(signals))])
        for way in (1, -1)
    )
    expected = (ahead - behind).T / (2 * STEP)
    found = linearise(posed, signals).by_signal
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())


@given(st.integers(0, 10_000), st.sampled_from(MOTIONS))
def test_by_heading_a_and_speed(seed, motion):
    posed, signals = case(seed, motion)
    found = linearise(posed, signals)
    p = posed.poses

    def difference(change):
        return (ends(change(STEP), signals) - ends(change(-STEP), signals)) / (2 * STEP)

    turned = difference(lambda h: replace(posed, poses=Poses(p.x, p.y, p.heading + h)))
    by_a = difference(lambda h: replace(posed, a=posed.a * (1 + h)))
    by_speed = difference(lambda h: replace(posed, speed=posed.speed * (1 + h)))
    for ours, expected in (
        (found.by_heading[0], turned),
        (found.by_a.sum(axis=0), by_a),
        (found.by_speed.sum(axis=0), by_speed),
    ):
        assert ours == pytest.approx(expected, rel=1e-4, abs=1e-4 * np.abs(expected).max())


def test_miss_onward_and_times():
    posed, signals = case(3, "exact")
    found = linearise(posed, signals)
    miss = np.hypot(*(ends(posed, signals) - posed.targets).T)
    assert found.miss == pytest.approx(miss)
    assert found.seconds.tolist() == [0.13, *[0.2] * 8]
    assert np.hypot(*found.onward.reshape(-1, 2).T) == pytest.approx(0.2 * posed.speed)

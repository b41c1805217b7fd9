"""Stages that bring a crowd nearer, and the plan for the whole way that they end with."""

from dataclasses import replace

import numpy as np
import pytest

from tetractl.control import crowd
from tetractl.control.cost import predict
from tetractl.control.optimizers.multistart import Multistart
from tetractl.core.plan import Limits, Problem
from tetractl.core.poses import Poses
from tetractl.core.setup import Bounds
from tetractl.model.obstacles import Obstacles

ARENA, RADIUS, SEPARATION = Bounds(0.0, 0.0, 3000.0, 3000.0), 47.0, 95.0


@pytest.fixture(scope="module")
def eight():
    """Eight robots on two rows, each to a place of its own, with turning rates in any order."""
    rng = np.random.default_rng(3)
    at = np.stack(np.meshgrid([300, 1100, 1900, 2700], [600, 2400]), axis=-1).reshape(-1, 2)
    x, y = at.T.astype(np.float64).copy()
    return Problem(
        poses=Poses(x, y, rng.uniform(-3, 3, 8)),
        targets=at[rng.permutation(8)] + np.array([0.0, 200.0]),
        a=rng.permutation(np.geomspace(2, 6, 8)),
        speed=np.full(8, 170.0),
        motion="exact",
        period=0.2,
        first_period=0.2,
        obstacles=Obstacles.of((), RADIUS, ARENA),
        obstacle_weight=1000.0,
        swept=True,
        separation=SEPARATION,
    )


def test_a_way_of_all_robots_is_easier_than_one_that_takes_two_alike_apart(eight):
    ease, alike = crowd.ease(eight), np.argsort(eight.a)[:2]
    together, apart = np.ones(8), np.zeros(8)
    apart[alike] = 2.0, -2.0  # of the same length
    assert np.linalg.norm(apart @ ease) > 3 * np.linalg.norm(together @ ease)


def test_robots_that_cannot_keep_clear_have_no_stage(eight):
    signals, left = crowd.stage(replace(eight, separation=3000.0), 10, 1, crowd.STAGE_KEPT)
    assert not len(signals)
    assert left == np.inf


def test_stages_bring_eight_robots_so_near_that_a_plan_brings_them_to_their_targets(eight):
    """Where random sequences and their polish leave metres."""
    now, clear, left = eight, True, np.inf
    for key in range(150):
        signals, left = crowd.stage(now, crowd.STAGE, key, crowd.STAGE_KEPT)
        if left < crowd.NEAR:
            break
        path = predict(now, signals[: crowd.HELD])
        x, y = path[1:, :, 0], path[1:, :, 1]
        clear &= not eight.obstacles.contain(x, y).any()
        now = replace(now, poses=Poses.of(path[-1].copy()))
    assert clear
    assert left < crowd.NEAR
    near, optimizer = replace(now, depth_weight=crowd.DEPTH_WEIGHT), Multistart()
    found = (
        optimizer.search(near, len(start), start, 1, Limits())
        for key in range(4)
        for start in crowd.whole(near, crowd.WHOLE, key)
    )
    assert min(one.cost for one in found) < 1
    assert optimizer.search(eight, crowd.WHOLE, None, 1, Limits()).cost > 1000

"""Tests of the measure of way-points and of the hold, frame by frame."""

import numpy as np
import pytest

from tetractl.core.losses import LossRule
from tetractl.core.poses import Observation, Poses, Sample
from tetractl.core.route_measure import HoldTask, RouteMeasure

LEGS = np.array([[[10.0, 0.0], [10.0, 5.0]], [[20.0, 0.0], [20.0, 5.0]], [[30.0, 0], [30.0, 5.0]]])
"""Two way-points of two robots, and their targets."""
SPEED = np.ones(2)
HOLD = HoldTask(radius=2.0, seconds=5.0)


def observation(xy, time_ns=0, valid=(True, True)):
    rows = np.column_stack([np.asarray(xy, dtype=float), np.zeros(2)])
    return Observation(0, time_ns, time_ns, Poses.from_array(rows), np.array(valid))


def sample(xy, time_ns, truth=None, valid=(True, True)):
    true = None if truth is None else Poses.from_array(np.column_stack([truth, np.zeros(2)]))
    return Sample(observation(xy, time_ns, valid), true)


def route(hold=HOLD):
    return RouteMeasure(LEGS, hold, None, SPEED)


def test_a_way_point_counts_by_the_sum_of_distances_when_it_is_passed():
    measure = route()
    assert measure.record_step(0, observation([[0, 0], [0, 5]])) == ""
    assert measure.record_step(1, observation([[13, 4], [10, 5]])) == "way-point 1 of 2 is passed"
    assert measure.record_step(1, observation([[15, 0], [15, 5]])) == ""
    assert measure.record_step(2, observation([[20, 1], [20, 7]])) == "way-point 2 of 2 is passed"
    assert measure.passed == pytest.approx((5.0, 3.0))


def test_way_points_passed_in_one_step_each_count():
    measure = route()
    assert measure.record_step(2, observation([[10, 0], [10, 5]])) == "way-point 2 of 2 is passed"
    assert measure.passed == pytest.approx((0.0, 20.0))


def test_the_hold_begins_after_the_targets_and_is_announced_once():
    measure = route()
    assert (
        measure.record_step(3, observation([[30, 0], [30, 5]]))
        == "the robots have arrived and hold"
    )
    assert measure.record_step(3, observation([[30, 0], [30, 5]])) == ""
    assert len(measure.passed) == 2


def test_only_frames_since_the_hold_began_count_and_only_robots_within_its_radius():
    measure = route()
    measure.add_samples([sample([[30, 0], [30, 5]], 50)])
    assert measure.inside == ()
    measure.record_step(3, observation([[30, 0], [30, 5]], time_ns=100))
    near, edge, far = [30.0, 1.0], [30.0, 7.0], [30.0, 7.01]
    measure.add_samples(
        [sample([near, far], 99), sample([near, edge], 100), sample([near, far], 200)]
    )
    measure.add_samples([sample([[33, 0], far], 300), sample([near, edge], 400)])
    assert measure.inside == pytest.approx((3 / 4, 2 / 4))


def test_an_untracked_robot_is_outside_unless_its_true_place_is_known():
    here = [[30.0, 0.0], [30.0, 5.0]]
    away = [[0.0, 0.0], [0.0, 0.0]]
    measure = route()
    measure.record_step(3, observation(here, time_ns=0))
    measure.add_samples([sample(here, 10, valid=(True, False))])
    assert measure.inside == (1.0, 0.0)
    measure.add_samples([sample(away, 20, truth=here, valid=(False, False))])
    assert measure.inside == (1.0, 0.5)
    measure.add_samples([sample(here, 30, truth=away)])
    assert measure.inside == pytest.approx((2 / 3, 1 / 3))


def test_frames_after_the_end_are_ignored():
    here = [[30.0, 0.0], [30.0, 5.0]]
    measure = route()
    measure.record_step(3, observation(here, time_ns=0))
    measure.add_samples(
        [sample(here, 10), sample(here, 20), sample([[0, 0], [0, 0]], 21)], until_ns=20
    )
    assert measure.inside == (1.0, 1.0)


def test_without_a_hold_there_is_nothing_inside():
    measure = route(hold=None)
    measure.record_step(3, observation([[30, 0], [30, 5]]))
    measure.add_samples([sample([[30, 0], [30, 5]], 10)])
    assert measure.inside == ()


def test_losses_are_empty_if_no_robot_was_lost():
    measure = route()
    measure.add_samples([sample([[0, 0], [0, 0]], 0)])
    assert measure.lost == ()
    lossy = RouteMeasure(LEGS, None, LossRule(0.1, False), SPEED)
    lossy.add_samples(
        [sample([[0, 0], [0, 0]], t * 10**7, valid=(True, t == 0)) for t in range(20)]
    )
    assert lossy.lost == (0, 1)


def test_a_robot_stood_if_it_is_dead_but_was_not_lost_for_it():
    frames = [sample([[k, 0], [0, 5]], k * 10**8) for k in range(70)]
    for rule, stood in (
        (None, [False, True]),
        (LossRule(0.3, False, includes_dead=True), [False, False]),
    ):
        measure = RouteMeasure(LEGS, None, rule, np.full(2, 10.0))
        measure.add_samples(frames)
        assert measure.dead_not_lost.tolist() == stood

"""Tests of verdicts and results: which robots went where they must not be, and what counts."""

import math
from dataclasses import replace

import numpy as np
import pytest
from testkit.batches import result

from tetractl.core.plan import Outcome
from tetractl.core.poses import Poses
from tetractl.core.trial import EMULATED_PLANT, REAL_DEVICE_FACT, PlantInfo, Verdict

VERDICT = Verdict(
    Poses.from_array(np.zeros((3, 3))),
    entered=(False, True, False),
    clearance=(5.0, 9.0, -1.0),
    edge=(5.0, 0.0, -1.0),
    apart=(10.0, 10.0, 12.0),
)


def test_a_robot_is_in_an_obstacle_if_its_path_touched_one_or_it_came_nearer_than_its_radius():
    assert VERDICT.in_obstacle() == [False, True, True]
    assert VERDICT.in_obstacle(5.0) == [False, True, True]
    assert VERDICT.in_obstacle(5.01) == [True, True, True]


def test_a_robot_is_over_the_edge_if_it_came_nearer_than_its_radius():
    assert VERDICT.over_edge() == [False, False, True]
    assert VERDICT.over_edge(5.0) == [False, True, True]
    assert VERDICT.over_edge(5.01) == [True, True, True]
    assert replace(VERDICT, edge=()).over_edge() == []


def test_two_robots_touch_if_their_centres_are_nearer_than_two_radii():
    assert VERDICT.touched() == [False] * 3
    assert VERDICT.touched(5.0) == [False] * 3
    assert VERDICT.touched(5.01) == [True, True, False]
    assert replace(VERDICT, apart=()).touched(5.0) == []


def test_of_an_unknown_end_nothing_is_claimed():
    unknown = Verdict.unknown(2)
    assert np.isnan(unknown.final.array()).all()
    assert unknown.in_obstacle(100.0) == [False, False]
    assert unknown.clearance == (math.inf, math.inf)
    assert not unknown.can_restart
    assert VERDICT.can_restart


def ended(**fields):
    return result([1.0, 2.0, 3.0], **({"verdict": VERDICT} | fields))


def test_a_result_tells_whether_any_robot_was_where_it_must_not_be():
    assert ended().entered_obstacle
    assert ended().left_arena
    good = replace(VERDICT, entered=(False,) * 3, clearance=(1.0,) * 3, edge=(0.0,) * 3)
    assert not ended(verdict=good).entered_obstacle
    assert not ended(verdict=good).left_arena
    assert not ended(verdict=replace(good, edge=())).left_arena


def test_a_summary_has_a_reason_if_there_is_one():
    assert ended(outcome=Outcome.ARRIVED, reason="", steps=4).summary == (
        "arrived after 4 control steps"
    )
    assert ended(outcome=Outcome.ABORTED, reason="it fell", steps=4).summary == (
        "aborted (it fell) after 4 control steps"
    )


def test_only_the_steps_in_which_robots_drove_have_to_keep_the_period():
    assert ended(solve_ns=(1, 2, 3), drove=(True, False, True)).driving_ns == (1, 3)
    assert ended(solve_ns=(1, 2, 3)).driving_ns == (2, 3)  # of an older log
    assert ended(solve_ns=()).driving_ns == ()


@pytest.mark.parametrize(
    ("kind", "simulated", "facts", "virtual"),
    [
        ("sim", True, {}, True),
        ("lab", False, {}, False),
        (EMULATED_PLANT, False, {}, True),
        (EMULATED_PLANT, False, {REAL_DEVICE_FACT: "camera"}, False),
        ("lab", False, {REAL_DEVICE_FACT: "camera"}, False),
    ],
)
def test_a_plant_without_a_real_device_runs_in_virtual_time(kind, simulated, facts, virtual):
    assert PlantInfo(kind, simulated, 120.0, facts).virtual is virtual

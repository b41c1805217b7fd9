"""Tests of how near robots came to the edge, to obstacles and to one another in a batch."""

from dataclasses import replace

import numpy as np
from testkit.batches import batch, experiment, group

from tetractl.core.poses import Poses
from tetractl.core.trial import Verdict
from tetractl.statistics.as_json import batch_items
from tetractl.statistics.flagged import flagged
from tetractl.statistics.tables import texts_by_label
from tetractl.statistics.trial_tables import trials_table

INF = float("inf")


def measured(index, edge=(), apart=(), clearance=(50.0, 60.0), spec=None):
    """A trial of two robots with the least distance of each to the edge, to the other robot and to
    an obstacle, all from the centres; older logs have the last alone.
    """
    (trial,) = batch([[1.0, 2.0]], spec)
    verdict = Verdict(
        final=Poses.from_array(np.zeros((2, 3))),
        entered=(False, False),
        clearance=clearance,
        edge=edge,
        apart=apart,
    )
    return replace(trial, trial=index, result=replace(trial.result, verdict=verdict))


def test_trials_that_left_the_arena_are_counted_and_the_nearest_of_all_is_told():
    trials = [
        measured(0, edge=(5.0, -1.0), apart=(95.0, 95.0)),
        measured(1, edge=(9.0, 8.0), apart=(200.0, 200.0), clearance=(INF, -3.0)),
        measured(2, edge=(7.0, 3.0), apart=(INF, INF)),
    ]
    items = batch_items(group(trials))
    assert items["left_arena"] == 1
    assert items["clearance"] == -3.0
    assert items["edge"] == -1.0
    assert items["apart"] == 95.0


def test_logs_without_those_distances_are_left_out():
    older = measured(0)
    newer = measured(1, edge=(4.0, 6.0), apart=(80.0, 80.0))
    items = batch_items(group([older, newer]))
    assert items["left_arena"] == 0
    assert items["edge"] == 4.0
    assert items["apart"] == 80.0


def batch_with_bodies():
    """Bodies have a radius of 47, two touch below a distance of 94: in trial 0 bodies do what
    centres do not, in trial 1 a centre leaves the arena and its body with it, in trial 2 none does.
    """
    spec = experiment(2, controller={"type": "mpc", "collision": {"radius": 47}})
    return group(
        [
            measured(0, edge=(46.0, 60.0), apart=(93.0, 93.0), clearance=(46.9, 60.0), spec=spec),
            measured(1, edge=(-1.0, 60.0), apart=(95.0, 95.0), clearance=(47.0, 60.0), spec=spec),
            measured(2, edge=(48.0, 60.0), apart=(95.0, 95.0), clearance=(48.0, 60.0), spec=spec),
        ]
    )


def test_centres_and_bodies_are_counted_apart_where_the_spec_gives_a_radius():
    items = batch_items(batch_with_bodies())
    assert items["body_radius"] == 47
    assert items["obstacle_violations"] == 0
    assert items["left_arena"] == 1
    assert items["body_in_obstacle"] == 1
    assert items["body_over_edge"] == 2
    assert items["bodies_touch"] == 1


def test_the_table_of_trials_has_a_column_for_centres_and_one_for_bodies():
    columns = trials_table(batch_with_bodies().batch).as_dict()
    assert columns["outside_arena"] == [False, True, False]
    assert columns["body_over_edge"] == [True, True, False]


def test_without_a_radius_centres_are_counted_and_said_to_be():
    described = group([measured(0, edge=(-1.0, 5.0), apart=(200.0, 200.0))])
    rows = texts_by_label(described)
    assert rows["left the arena"] == "1 of 1 (95 % interval 21 to 100 %), counting centres"
    assert rows["touched one another"] == "- (no radius)"
    items = batch_items(described)
    assert items["body_over_edge"] is None
    assert items["bodies_touch"] is None


def test_a_batch_without_those_distances_has_none():
    items = batch_items(group([measured(0, clearance=(INF, INF))]))
    assert items["clearance"] is None
    assert items["edge"] is None
    assert items["apart"] is None


def test_tables_count_bodies_where_the_spec_gives_a_radius():
    rows = texts_by_label(batch_with_bodies())
    assert rows["left the arena"] == "2 of 3 (95 % interval 21 to 94 %), counting bodies"
    assert rows["touched one another"].startswith("1 of 3")


def test_a_flagged_trial_names_the_robots_whose_bodies_did_it():
    assert flagged(batch_with_bodies().batch)[0].notes == (
        "green entered an obstacle",
        "green left the arena",
        "green, blue touched one another",
    )

from dataclasses import replace

import numpy as np
from support.batches import batch, experiment, group

from tetractl.core.commands import Verdict
from tetractl.core.poses import Poses
from tetractl.results.as_json import batch_items
from tetractl.results.batch_rows import texts_by_label
from tetractl.results.flagged import flagged
from tetractl.results.trial_tables import trials_table

INF = float("inf")


def judged(index, edge=(), apart=(), clearance=(50.0, 60.0), spec=None):
    (trial,) = batch([[1.0, 2.0]], spec)
    verdict = Verdict(Poses.of(np.zeros((2, 3))), (False, False), clearance, "", edge, apart)
    return replace(trial, trial=index, result=replace(trial.result, verdict=verdict))


def test_trials_that_left_the_arena_are_counted_and_the_nearest_of_all_is_told():
    trials = [
        judged(0, (5.0, -1.0), (95.0, 95.0)),
        judged(1, (9.0, 8.0), (200.0, 200.0), (INF, -3.0)),
        judged(2, (7.0, 3.0), (INF, INF)),
    ]
    items = batch_items(group(trials))
    assert items["left_arena"] == 1
    assert (items["clearance"], items["edge"], items["apart"]) == (-3.0, -1.0, 95.0)


def test_logs_without_those_distances_are_left_out():
    items = batch_items(group([judged(0), judged(1, (4.0, 6.0), (80.0, 80.0))]))
    assert (items["left_arena"], items["edge"], items["apart"]) == (0, 4.0, 80.0)
    alone = batch_items(group([judged(0, clearance=(INF, INF))]))
    assert alone["clearance"] is alone["edge"] is alone["apart"] is None


def test_bodies_are_counted_where_the_spec_gives_their_radius_and_centres_beside_them():
    spec = experiment(2, controller={"type": "mpc", "collision": {"radius": 47}})
    trials = [
        judged(0, (46.0, 60.0), (93.0, 93.0), (46.9, 60.0), spec),  # bodies alone
        judged(1, (-1.0, 60.0), (95.0, 95.0), (47.0, 60.0), spec),  # a centre, thus its body
        judged(2, (48.0, 60.0), (95.0, 95.0), (48.0, 60.0), spec),
    ]
    found = group(trials)
    items = batch_items(found)
    assert items["body_radius"] == 47
    assert (items["obstacle_violations"], items["left_arena"]) == (0, 1)
    assert (items["body_in_obstacle"], items["body_over_edge"], items["bodies_touch"]) == (1, 2, 1)
    rows = texts_by_label(found)
    assert rows["left the arena"] == "2 of 3 (95 % interval 21 to 94 %), counting bodies"
    assert rows["touched one another"].startswith("1 of 3")
    columns = trials_table(found.batch).as_dict()
    assert columns["outside_arena"] == [False, True, False]
    assert columns["body_over_edge"] == [True, True, False]
    assert flagged(found.batch)[0].notes == (
        "green entered an obstacle",
        "green left the arena",
        "green, blue touched one another",
    )


def test_without_a_radius_centres_are_counted_and_said_to_be():
    found = group([judged(0, (-1.0, 5.0), (200.0, 200.0))])
    rows = texts_by_label(found)
    assert rows["left the arena"] == "1 of 1 (95 % interval 21 to 100 %), counting centres"
    assert rows["touched one another"] == "- (no radius)"
    items = batch_items(found)
    assert items["body_over_edge"] is items["bodies_touch"] is None

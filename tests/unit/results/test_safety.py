from dataclasses import replace

import numpy as np
from support.batches import batch, group

from tetractl.core.commands import Verdict
from tetractl.core.poses import Poses

INF = float("inf")


def judged(index, edge=(), apart=(), clearance=(50.0, 60.0)):
    (trial,) = batch([[1.0, 2.0]])
    verdict = Verdict(Poses.of(np.zeros((2, 3))), (False, False), clearance, "", edge, apart)
    return replace(trial, trial=index, result=replace(trial.result, verdict=verdict))


def test_trials_that_left_the_arena_are_counted_and_the_nearest_of_all_is_told():
    trials = [
        judged(0, (5.0, -1.0), (95.0, 95.0)),
        judged(1, (9.0, 8.0), (200.0, 200.0), (INF, -3.0)),
        judged(2, (7.0, 3.0), (INF, INF)),
    ]
    items = group(trials).items
    assert items["left_arena"] == 1
    assert (items["clearance"], items["edge"], items["apart"]) == (-3.0, -1.0, 95.0)


def test_logs_without_those_distances_are_left_out():
    items = group([judged(0), judged(1, (4.0, 6.0), (80.0, 80.0))]).items
    assert (items["left_arena"], items["edge"], items["apart"]) == (0, 4.0, 80.0)
    alone = group([judged(0, clearance=(INF, INF))]).items
    assert alone["clearance"] is alone["edge"] is alone["apart"] is None

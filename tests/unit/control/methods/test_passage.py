"""Tests of paths through narrow gaps that robots pass one after another."""

from dataclasses import replace

import numpy as np
import pytest
from testkit.paths import ROOT
from testkit.trials import experiment

from tetractl.control.methods import passage
from tetractl.control.methods.passage import CellGrid, find_sequences
from tetractl.control.search.cost import predict
from tetractl.control.search.discs import Discs
from tetractl.control.search.optimizers.multistart import Multistart
from tetractl.core.obstacles import Obstacles
from tetractl.core.plan import Limits
from tetractl.core.setup import Bounds
from tetractl.spec.load import load_spec

RADIUS = 47.0
SEPARATION = 95.0
STARTS = (800.0, 900.0), (650.0, 1500.0), (950.0, 1800.0)
TARGETS = (1700.0, 800.0), (1900.0, 1300.0), (1650.0, 1700.0)


def walled(gap, middle=1200.0, robots=3):
    """The spec of three robots on the left of a wall with a gap, with targets on its right."""
    wall = {"type": "rectangle", "left": 1250.0, "width": 100.0}
    low = middle - gap / 2
    high = middle + gap / 2
    below = wall | {"bottom": 350.0, "height": low - 350}
    above = wall | {"bottom": high, "height": 2150 - high}
    robots_of_spec = experiment().model_dump(mode="json")["robots"][:robots]
    placed = [
        robot | {"start": start, "target": target}
        for robot, start, target in zip(robots_of_spec, STARTS, TARGETS, strict=False)
    ]
    controller = {
        "type": "mpc",
        "horizon_max": 200,
        "accept_error": 12,
        "collision": {"radius": RADIUS, "separation": SEPARATION},
    }
    return experiment(robots=placed, obstacles=[below, above], controller=controller)


def problem_of(spec):
    setup = spec.setup
    discs = Discs(RADIUS, setup.obstacles, setup.arena)
    return spec.controller.problem(setup), discs, setup.arena


def test_the_lengths_of_ways_are_those_round_what_is_not_free():
    """A wall across 30 of 50 rows: from below it, round its end, to a target above it."""
    grid = CellGrid(Bounds(0.0, 0.0, 90.0, 50.0))
    assert grid.shape == (50, 90)
    free = np.ones(grid.shape, dtype=np.bool_)
    free[20, :60] = False
    targets = np.array([[30.5, 30.5], [80.5, 10.5]])
    to_first, to_second = grid.path_lengths(free.ravel(), targets).reshape(2, 50, 90)
    # ten rows up on either side of the wall's end
    diagonal = np.sqrt(2)
    turns = 60 - 30 - 10
    assert to_first[10, 30] == pytest.approx(20 * diagonal + 2 * turns)
    assert to_first[30, 32] == pytest.approx(2)
    assert to_second[10, 80] == 0
    assert np.isinf(to_first[20, 10])


def test_ways_lead_all_robots_near_their_targets_and_keep_clear():
    problem, discs, arena = problem_of(walled(260))
    signals, again = (next(find_sequences(problem, arena, 200, key=5)) for _ in range(2))
    assert np.array_equal(signals, again)
    path = predict(problem, signals)
    missed = np.hypot(*(path[-1, :, :2] - problem.targets).T).sum()
    assert missed < passage.DISTANCE_LEFT * (problem.speed / problem.a).sum()
    assert (
        discs.min_clearance(path[..., 0], path[..., 1], SEPARATION).min() > -1.0
    )  # between moments
    passed = (path[..., 0] > 1300).argmax(axis=0)
    assert len(set(passed.tolist())) == 3


def test_there_is_no_way_through_a_wall():
    problem, _, arena = problem_of(walled(260))
    closed = walled(60).setup  # narrower than a robot by more than a cell
    region = Obstacles.from_shapes(closed.obstacles, RADIUS, closed.arena)
    nearest = list(find_sequences(replace(problem, obstacles=region), arena, 200, key=5))
    assert not nearest or (predict(problem, nearest[0])[..., 0] < 1300).all()


@pytest.mark.long
def test_a_polish_from_the_tree_leads_robots_from_anywhere_to_anywhere():
    """Four robots to places of their own in 2.4 m: no search from random sequences finds a plan,
    and those from the tree do so with 55 of 60 keys."""
    spec = load_spec(ROOT / "experiments/benchmark/anywhere.yaml").experiment
    problem = spec.controller.problem(spec.setup)
    optimizer = Multistart()
    assert optimizer.search(problem, 134, None, 0, Limits()).cost > 100
    keys_that_lead_there = []
    for key in range(3):
        starts = find_sequences(problem, spec.setup.arena, 134, key)
        searches = (optimizer.search(problem, len(start), start, key, Limits()) for start in starts)
        if min(search.cost for search in searches) < 1:
            keys_that_lead_there.append(key)
    assert len(keys_that_lead_there) >= 2

"""Ways through passages that robots pass one after the other."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree
from support.trials import experiment

from tetractl.control import passage
from tetractl.control.cost import predict
from tetractl.control.margins import Margins
from tetractl.control.passage import Squares, narrow, ways
from tetractl.core.plan import State
from tetractl.core.setup import Bounds
from tetractl.experiment.load import LoadedSpec
from tetractl.log.read.reader import read_trial
from tetractl.model.obstacles import Obstacles
from tetractl.run.task import log_path, run_trial

RADIUS, SEPARATION = 47.0, 95.0
STARTS = (800.0, 900.0), (650.0, 1500.0), (950.0, 1800.0)
TARGETS = (1700.0, 800.0), (1900.0, 1300.0), (1650.0, 1700.0)


def walled(gap, middle=1200.0, robots=3):
    """The spec of three robots on the left of a wall with a gap, with targets on its right."""
    wall = {"type": "rectangle", "left": 1250.0, "width": 100.0}
    low, high = middle - gap / 2, middle + gap / 2
    below = wall | {"bottom": 350.0, "height": low - 350}
    above = wall | {"bottom": high, "height": 2150 - high}
    each = experiment().model_dump(mode="json")["robots"][:robots]
    placed = [
        one | {"start": start, "target": target}
        for one, start, target in zip(each, STARTS, TARGETS, strict=False)
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
    margins = Margins(setup.obstacles, setup.arena, setup.targets, RADIUS)
    return spec.controller.problem(setup), margins, setup.arena


@pytest.mark.parametrize(
    ("gap", "robots", "expected"),
    [(260, 3, True), (260, 2, False), (150, 2, True), (150, 1, False), (400, 3, False)],
)
def test_a_gap_is_narrow_if_the_robots_do_not_fit_side_by_side(gap, robots, expected):
    assert narrow(*problem_of(walled(gap, robots=robots))) is expected


def test_robots_near_a_wall_have_a_passage_only_if_one_is_between_them_and_their_targets():
    spec = walled(260)
    problem, margins, arena = problem_of(spec)
    beyond = np.array(TARGETS) - (300.0, 0.0)
    poses = replace(problem.poses, x=beyond[:, 0], y=beyond[:, 1])
    assert not narrow(replace(problem, poses=poses), margins, arena)


def test_a_way_round_a_narrow_gap_makes_it_no_passage():
    problem, _, arena = problem_of(walled(260))
    below, above = walled(260).setup.obstacles
    for shapes, expected in (([below, above], True), ([below], False), ([], False)):
        open_to = Margins(shapes, arena, problem.targets, RADIUS)
        region = Obstacles.of(shapes, RADIUS, arena)
        assert narrow(replace(problem, obstacles=region), open_to, arena) is expected


def test_the_lengths_of_ways_are_those_of_dijkstra():
    arena, rng = Bounds(0.0, 0.0, 90.0, 50.0), np.random.default_rng(1)
    grid = Squares(arena)
    assert grid.shape == (50, 90)
    free = rng.random(4500) < 0.7
    target = np.array([44.5, 20.5])
    free[grid.cells(target)] = True
    one, other = KDTree(grid.centres).query_pairs(1.5, output_type="ndarray").T
    both = free[one] & free[other]
    one, other = one[both], other[both]
    gap = np.hypot(*(grid.centres[one] - grid.centres[other]).T)
    graph = coo_array((gap, (one, other)), shape=(4500, 4500)).tocsr()
    expected = dijkstra(graph, directed=False, indices=int(grid.cells(target)))
    assert np.allclose(grid.ways(free, target), np.where(free, expected, np.inf))


def test_ways_lead_all_robots_near_their_targets_and_keep_clear():
    problem, margins, arena = problem_of(walled(260))
    signals, again = (next(ways(problem, arena, 200, key=5)) for _ in range(2))
    assert np.array_equal(signals, again)
    path = predict(problem, signals)
    missed = np.hypot(*(path[-1, :, :2] - problem.targets).T).sum()
    assert missed < passage.NEAR * (problem.speed / problem.a).sum()
    half_a_cell = 1800 / passage.CELLS / 2
    assert margins.room(path[..., 0], path[..., 1], SEPARATION).min() > -np.sqrt(2) * half_a_cell
    passed = (path[..., 0] > 1300).argmax(axis=0)
    assert len(set(passed.tolist())) == 3


def test_there_is_no_way_through_a_wall():
    problem, _, arena = problem_of(walled(260))
    closed = walled(60).setup  # narrower than a robot by more than a cell
    region = Obstacles.of(closed.obstacles, RADIUS, closed.arena)
    assert not list(ways(replace(problem, obstacles=region), arena, 200, key=5))


def test_three_robots_pass_a_gap_one_after_the_other_to_their_targets(tmp_path):
    spec = walled(260)
    result = run_trial(LoadedSpec(spec, "", ""), tmp_path)
    states = [step.plan.state for step in read_trial(log_path(tmp_path, 0)).steps]
    assert states[0] is State.PASSING
    assert result.total_error < 12
    assert min(result.verdict.clearance) > RADIUS

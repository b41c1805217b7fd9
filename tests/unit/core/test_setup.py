"""The arena as a rectangle, edge included, and distances of robots to their targets."""

import numpy as np
import pytest
from testkit.random_trials import experiment

from tetractl.core.setup import Bounds

BOUNDS = Bounds(-2.0, 1.0, 5.0, 4.0)


@pytest.mark.parametrize("x", np.arange(-3, 6.5, 0.5).tolist())
def test_a_rectangle_contains_its_inside_and_its_whole_edge(x):
    """`contains` and `inside` agree, also exactly on an edge and in a corner."""
    for y in np.arange(0, 5.5, 0.5).tolist():
        is_inside = -2 <= x <= 5 and 1 <= y <= 4
        assert BOUNDS.contains(x, y) == is_inside
        assert (BOUNDS.depth_inside(np.array([x]), np.array([y]))[0] >= 0) == is_inside


@pytest.mark.parametrize(("x", "on_x"), [(-2, True), (1.5, False), (5, True)])
@pytest.mark.parametrize(("y", "on_y"), [(1, True), (2.5, False), (4, True)])
def test_the_edge_is_where_the_distance_is_0(x, on_x, y, on_y):
    assert BOUNDS.contains(x, y)
    distance = BOUNDS.depth_inside(np.array([float(x)]), np.array([float(y)]))[0]
    assert (distance == 0) == (on_x or on_y)


def test_beyond_an_edge_by_the_least_is_outside():
    for x, y in ((-2, 2), (5, 2), (0, 1), (0, 4)):
        assert BOUNDS.contains(x, y)
    for x, y in (
        (np.nextafter(-2, -9), 2), (np.nextafter(5, 9), 2),
        (0, np.nextafter(1, -9)), (0, np.nextafter(4, 9)),
    ):  # fmt: skip
        assert not BOUNDS.contains(x, y)
    assert not BOUNDS.contains(np.nan, 2)
    assert not BOUNDS.contains(0, np.nan)


def test_the_sides_of_a_rectangle():
    assert (BOUNDS.width, BOUNDS.height, BOUNDS.longer_side) == (7, 3, 7)
    assert Bounds(1, -2, 4, 5).longer_side == 7


def test_distances_are_those_to_the_targets():
    setup = experiment(3).setup
    moved = setup.targets + np.array([[3.0, 4.0], [0.0, 0.0], [-5.0, 12.0]])
    assert setup.distances(moved) == pytest.approx([5, 0, 13])


@pytest.mark.parametrize("robots", [[0], [2, 0], [1, 2, 3], [3, 2, 1, 0]])
def test_a_setup_of_some_robots_has_the_values_of_these_in_their_order(robots):
    whole = experiment(4).setup
    some = whole.select_robots(robots)
    assert list(some.names) == [f"robot {i}" for i in robots]
    assert list(some.colors) == [whole.colors[i] for i in robots]
    assert some.a.tolist() == whole.a[robots].tolist()
    assert some.speed.tolist() == whole.speed[robots].tolist()
    assert some.targets.tolist() == whole.targets[robots].tolist()
    assert some.starts.array().tolist() == whole.starts.array()[robots].tolist()
    assert some.legs.tolist() == whole.legs[:, robots].tolist()
    assert some.arena == whole.arena

"""Tests of deciding whether a target is walled off, which must never be claimed wrongly."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import label
from testkit.bounded import shapes, spec

from tetractl.core.obstacles import Obstacles
from tetractl.core.poses import Poses
from tetractl.core.setup import Bounds
from tetractl.model.free_space import (
    blocked_target_distances,
    compute_clearances,
    find_connected_cells,
)

pytestmark = pytest.mark.slow


def wall(x, y, width, height):
    """A rectangle, by its lower left corner."""
    return {"type": "rectangle", "left": x, "bottom": y, "width": width, "height": height}


def setup(*obstacles, start=(100, 500), target=(900, 500)):
    return placed(shapes(obstacles), start, target)


def placed(obstacles, start, target):
    drawn = spec(np.random.default_rng(1), robots=1, signals=5).setup
    starts = Poses.from_array(np.array([[*start, 0.0]]))
    return replace(drawn, starts=starts, targets=np.array([target]), obstacles=obstacles)


WALL = wall(480, -100, 40, 1200)
CUP = [wall(700, 300, 20, 400), wall(700, 300, 300, 20), wall(700, 680, 300, 20)]


def test_a_wall_across_the_arena_shuts_out():
    (apart,) = blocked_target_distances(setup(WALL), 0.0, has_walls=True)
    assert 420 - 10 < apart <= 420  # from the wall's left side to the target


def test_a_target_in_a_cup_that_the_arenas_edge_closes():
    assert blocked_target_distances(setup(*CUP), 0.0, has_walls=True) > 150
    assert blocked_target_distances(setup(*CUP), 0.0, has_walls=False) == [0]


@pytest.mark.parametrize(
    ("gap", "margin", "open_"), [(20, 0, True), (20, 9, True), (20, 18, False)]
)
def test_a_gap_is_as_wide_as_the_margin_leaves_it(gap, margin, open_):
    halves = [wall(480, -100, 40, 600 - gap / 2), wall(480, 500 + gap / 2, 40, 600)]
    assert (blocked_target_distances(setup(*halves), margin, has_walls=True) == 0) == open_


def test_the_clearance_counts_walls_where_there_are_any():
    walled = setup(WALL)
    x = np.array([100.0, 20.0])
    y = np.array([500.0, 500.0])
    np.testing.assert_allclose(compute_clearances(walled, x, y, has_walls=True), [100, 20])
    np.testing.assert_allclose(compute_clearances(walled, x, y, has_walls=False), [380, 460])


@pytest.mark.long
@pytest.mark.parametrize("margin", [0.0, 15.0])
@pytest.mark.parametrize("seed", range(3))
def test_where_a_random_path_goes_nothing_is_shut_out(seed, margin):
    """Obstacles anywhere but on a random path: however narrow what is left, it is a way."""
    rng = np.random.default_rng(seed)
    path = rng.uniform(50, 950, (6, 2))
    places = rng.uniform(0, 1000, (2, 150))
    sizes = rng.uniform(5, 250, 150)
    things = []
    for x, y, size in zip(*places, sizes, strict=True):
        things.append(wall(x, y, size, rng.uniform(5, 250)))
        things.append({"type": "circle", "center": [x, y], "radius": size / 2})

    def is_off_the_path(shape):
        return (
            not Obstacles.from_shapes([shape], margin)
            .meets_segments(*path[:-1].T, *path[1:].T)
            .any()
        )

    obstacles = list(filter(is_off_the_path, shapes(things)))
    assert len(obstacles) > 20
    assert blocked_target_distances(
        placed(obstacles, path[0], path[-1]), margin, has_walls=True
    ) == [0]


SIZES = st.integers(1, 30)


@given(seed=st.integers(0, 2**32), rows=SIZES, columns=SIZES, share=st.floats(0.3, 0.8))
def test_cells_are_connected_as_scipy_labels_them(seed, rows, columns, share):
    rng = np.random.default_rng(seed)
    free = rng.random((rows, columns)) < share
    cells = rng.random((rows, columns)) < 0.01
    regions, _ = label(free, np.ones((3, 3)))
    expected = np.isin(regions, regions[cells & free])
    assert np.array_equal(find_connected_cells(cells, free), expected)


WIDE = Bounds(0, 0, 1000, 600)
THINGS = [(480, -100, 40, 650), (700, 200, 20, 500), (700, 200, 400, 20), (0, 300, 400, 25)]


def exchanged(x, y, width, height):
    """A rectangle with the axes exchanged; a point, of no width and height, too."""
    return y, x, height, width


def left_to_right(x, y, width, height):
    return WIDE.right - x - width, y, width, height


def upside_down(x, y, width, height):
    return x, WIDE.top - y - height, width, height


def shut_out_of(change, arena, start, target, walls):
    """The result in a world that is changed."""
    things = [wall(*change(*thing)) for thing in THINGS]
    (start_x, start_y, *_), (target_x, target_y, *_) = change(*start, 0, 0), change(*target, 0, 0)
    world = placed(shapes(things), (start_x, start_y), (target_x, target_y))
    return blocked_target_distances(replace(world, arena=arena), 5.0, walls)


@pytest.mark.parametrize("walls", [True, False])
@pytest.mark.parametrize(
    ("start", "target"),
    [((100, 200), (900, 300)), ((500, 50), (850, 560)), ((30, 580), (60, 30))],
)
def test_in_mirrors_nothing_changes(start, target, walls):
    """In an arena that is wider than tall."""
    least = shut_out_of(lambda *thing: thing, WIDE, start, target, walls)
    for change, arena in (
        (exchanged, Bounds(0, 0, 600, 1000)),
        (left_to_right, WIDE),
        (upside_down, WIDE),
    ):
        found = shut_out_of(change, arena, start, target, walls)
        assert found == pytest.approx(least, abs=1e-6)


def test_how_near_a_robot_comes_is_never_overstated():
    """A box around the target, of which the walls are 40 thick."""
    sides = [(740, 340, 320, 40), (740, 620, 320, 40), (740, 340, 40, 320), (1020, 340, 40, 320)]
    boxed = replace(
        setup(*(wall(*side) for side in sides), target=(900, 500)), arena=Bounds(0, 0, 1200, 1000)
    )
    for margin in (0.0, 20.0):
        (apart,) = blocked_target_distances(boxed, margin, has_walls=True)
        assert 160 + margin - 20 < apart <= 160 + margin
        (outside,) = blocked_target_distances(boxed, margin, has_walls=False)
        assert outside == pytest.approx(apart)


def test_each_robot_has_a_start_and_a_target_of_its_own():
    alone = setup(WALL)
    both = replace(
        alone,
        starts=Poses.from_array(np.array([[100.0, 500, 0], [900, 300, 0]])),
        targets=np.array([[900.0, 500], [950.0, 700]]),
    )
    first, second = blocked_target_distances(both, 0.0, has_walls=True)
    assert first > 400
    assert second == 0


def test_of_a_start_inside_an_obstacle_or_nearer_than_the_margin_nothing_is_said():
    assert blocked_target_distances(setup(WALL, start=(500, 500)), 0.0, has_walls=True) == [0]
    assert blocked_target_distances(setup(WALL, start=(470, 500)), 40.0, has_walls=True) == [0]
    assert blocked_target_distances(setup(WALL, start=(430, 500)), 40.0, has_walls=True) > 400


@pytest.mark.parametrize("start", [(0, 0), (1000, 0), (0, 1000), (1000, 1000)])
def test_corners_of_the_arena_are_places_too(start):
    far = (1000 - start[0], 1000 - start[1])
    assert blocked_target_distances(setup(start=start, target=far), 0.0, has_walls=True) == [0]


def test_a_wall_that_ends_at_the_arenas_edge_is_passed_only_outside():
    assert blocked_target_distances(setup(wall(480, 0, 40, 1000)), 0.0, has_walls=True) > 400
    assert blocked_target_distances(setup(wall(480, 0, 40, 1000)), 0.0, has_walls=False) == [0]

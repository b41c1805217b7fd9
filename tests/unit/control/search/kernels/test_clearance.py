"""Tests that the compiled clearance equals that of the readable obstacle region."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.shapes import SHAPES

from tetractl.control.search.kernels import clearance
from tetractl.control.search.kernels.obstacles import arrays_of
from tetractl.core import elementwise
from tetractl.core.obstacles import Obstacles
from tetractl.core.setup import Bounds
from tetractl.tools.kernels import kernel_options as options

pytestmark = pytest.mark.slow

WALLS = st.none() | st.just(Bounds(-8.0, -7.5, 9.0, 7.0))
REGIONS = st.builds(
    lambda sections, margin, walls: Obstacles.from_shapes(
        [s.shape() for s in sections], margin, walls
    ),
    st.lists(SHAPES, max_size=3),
    st.sampled_from([0.0, 0.25, 1.0]),
    WALLS,
)
POINTS = st.tuples(st.floats(-12, 12), st.floats(-12, 12))
PATHS = st.lists(POINTS, min_size=4, max_size=12)


@given(REGIONS, PATHS)
def test_gaps_are_those_of_the_readable_region_to_the_last_bit(region, points):
    x, y = np.array(points).T.copy()
    distances = np.empty((region.count, len(x)))
    clearance.distances_to_obstacles(arrays_of(region), x, y, distances)
    assert np.array_equal(distances, region.distances(x, y))


@given(PATHS)
def test_the_least_distance_is_that_of_the_nearest_two(points):
    x, y = np.array(points).T.copy()
    distances = elementwise.hypot(x[:, None] - x, y[:, None] - y)
    of_pairs = distances[np.triu_indices(len(x), 1)]
    assert clearance.min_pair_distance(x, y) == of_pairs.min()


OPTIONS = ["INLINE_EXACT", "ENTRY", "PART_FAST", "INLINE_FAST", "ENTRY_FAST"]


@pytest.mark.parametrize("name", OPTIONS)
def test_no_kernel_inherits_the_options_of_its_first_caller(name):
    """Regression: compiled after a fast caller, distances were fast too; last bits differed."""
    assert {"fastmath", "error_model", "nogil", "_nrt"} <= vars(options)[name].keys()

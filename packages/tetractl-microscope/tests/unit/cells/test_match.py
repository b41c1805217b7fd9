"""Tests of assigning blobs to cells and specks by their cost."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from tetractl_microscope.cells.cell import BodySize, PathBlob
from tetractl_microscope.cells.match import (
    EM_ITERATIONS,
    EM_PIXELS_MAX,
    FORBIDDEN_COST,
    NO_BLOB_COST,
    NO_BLOB_SPECK_COST,
    NO_BLOB_SPECK_INCREASE,
    POSITION_SD_UM,
    SHARED_COST,
    SHARED_LARGE_COST,
    SIZE_COST_MAX,
    SIZE_VARIATION,
    SPECK_COST_MIN,
    SPECK_SD,
    STOPPED_COST_MAX,
    STOPPED_COST_MIN,
    STOPPED_REACH,
    CellCosts,
    SpeckCosts,
    _compute_shared_costs,
    assign_blobs,
    compute_cell_costs,
    compute_speck_costs,
    find_centres_in_blob,
)
from tetractl_microscope.cells.picture_now import NewestImage
from tetractl_microscope.cells.specks import Speck
from tetractl_microscope.organisms import TETRAHYMENA

CELL_UM2 = 100.0


@pytest.mark.parametrize(
    ("times_as_large", "missed_s", "cost"),
    [
        (2.0, 0.0, SHARED_LARGE_COST),
        (1.0, 0.0, SHARED_COST),
        (2.0, 0.1, SHARED_LARGE_COST),
        (1.0, 0.1, NO_BLOB_COST),
    ],
)
def test_a_blob_too_large_for_one_cell_is_shared_at_less_cost(times_as_large, missed_s, cost):
    """One of the size of a cell, by none that was not seen before."""
    size = SimpleNamespace(width=5.0, area_um2=CELL_UM2)
    cell = SimpleNamespace(size=size, missed_s=missed_s)
    pixels = np.array([[50.0, 50.0]])
    blob = SimpleNamespace(x=50.0, y=50.0, length=20.0, width=5.0 * times_as_large, pixels=pixels)
    assert _compute_shared_costs([cell], pixels, [blob], um_px=1.0).tolist() == [[cost]]


ORGANISM = TETRAHYMENA
LENGTH_UM, WIDTH_UM = ORGANISM.body_um
NOW = NewestImage(seconds=1.0, since_previous_s=1 / 30, um_px=2.0, height=500, width=500)
SPREAD = 9.0 * np.eye(2)[None]


def size_of(scale=1.0):
    return BodySize(LENGTH_UM * scale, WIDTH_UM * scale)


def cell_seen(missed_s=0.0):
    return SimpleNamespace(size=size_of(), missed_s=missed_s)


def costs_at(dx, dy=0.0, scale=1.0, missed_s=0.0):
    """The cost of a blob so far from where a cell is expected [um], and whether it is away."""
    places = np.array([[400 + dx, 400 + dy, 0.3, LENGTH_UM * scale, WIDTH_UM * scale]])
    expected = np.array([[400.0, 400.0, 0.3]])
    blob = SimpleNamespace(x=0.0, y=0.0, length=1.0, width=1.0, pixels=np.zeros((1, 2)))
    costs = compute_cell_costs(
        [cell_seen(missed_s)], expected, SPREAD, [blob], places, NOW, ORGANISM
    )
    assert costs.shared_blob.tolist() == [[NO_BLOB_COST]]
    return float(costs.own_blob[0, 0]), bool(costs.is_away[0, 0])


@pytest.mark.parametrize(("dx", "dy"), [(0.0, 0.0), (6.0, 0.0), (0.0, -6.0), (5.0, 12.0)])
def test_a_blob_near_a_cell_costs_its_squared_deviation(dx, dy):
    variance = 9.0 + POSITION_SD_UM**2
    assert costs_at(dx, dy) == (pytest.approx((dx**2 + dy**2) / variance), False)


def test_a_blob_of_another_size_costs_more_up_to_a_limit():
    costs = [costs_at(0.0, scale=scale)[0] for scale in (1.0, 1.1, 1.3, 5.0)]
    assert costs[0] == 0.0
    assert costs[1] == pytest.approx(2 * (math.log(1.1) / SIZE_VARIATION) ** 2)
    assert costs == sorted(costs)
    assert costs[-1] == SIZE_COST_MAX
    assert costs_at(0.0, scale=1 / 1.1)[0] == pytest.approx(costs[1])


def test_a_blob_of_the_cells_size_farther_off_may_be_a_cell_that_has_stopped():
    reach = STOPPED_REACH * LENGTH_UM
    cost, is_away = costs_at(0.9 * reach)
    assert is_away
    assert cost == pytest.approx(STOPPED_COST_MIN + (STOPPED_COST_MAX - STOPPED_COST_MIN) * 0.81)
    assert costs_at(1.1 * reach) == (NO_BLOB_COST, False)  # too far
    assert costs_at(0.9 * reach, scale=1.6) == (NO_BLOB_COST, False)  # too large
    assert costs_at(0.9 * reach, scale=0.6) == (NO_BLOB_COST, False)  # too small
    assert costs_at(1.05 * reach, missed_s=0.05)[1]  # farther, the longer it had no blob
    assert costs_at(0.9 * reach, missed_s=0.5) == (NO_BLOB_COST, False)  # lost too long ago


def speck_at(*path):
    """A speck with blobs at these times [s] and x [um]."""
    return Speck(1, [PathBlob(s, x, 100.0, 0.0, LENGTH_UM, WIDTH_UM) for s, x in path])


def test_a_speck_takes_the_blob_where_its_motion_leads():
    passed = 1 / 30
    speck = speck_at((0.0, 100.0), (passed, 110.0), (2 * passed, 120.0))
    xs = [130.0, 130.0 + 0.1 * LENGTH_UM, 130.0 + 0.9 * LENGTH_UM, 120.0]
    places = np.array([[x, 100.0, 0.0, LENGTH_UM, WIDTH_UM] for x in xs])
    costs = compute_speck_costs([speck], places, 3 * passed, passed, ORGANISM)
    ahead, near, far, behind = costs.blobs[0]
    assert ahead == pytest.approx(SPECK_COST_MIN)
    assert near == pytest.approx(SPECK_COST_MIN + (0.1 / SPECK_SD) ** 2)
    assert far == FORBIDDEN_COST
    assert SPECK_COST_MIN < behind < costs.no_blob[0]
    assert costs.no_blob.tolist() == [NO_BLOB_SPECK_COST + 3 * NO_BLOB_SPECK_INCREASE]


def test_a_long_known_speck_is_given_up_at_the_cost_of_a_cell():
    speck = speck_at(*((number / 30, 100.0) for number in range(40)))
    costs = compute_speck_costs([speck], np.zeros((0, 5)), 2.0, 1 / 30, ORGANISM)
    assert costs.no_blob.tolist() == [NO_BLOB_COST]


def cheapest(cells):
    """The lowest total cost of all ways to give blobs to cells, one after the other."""
    count, blobs = cells.own_blob.shape
    ways = [
        [
            (NO_BLOB_COST, None),
            *((cells.own_blob[i, j], j) for j in range(blobs)),
            *((cells.shared_blob[i, j], None) for j in range(blobs)),
        ]
        for i in range(count)
    ]
    totals = []
    for way in itertools.product(*ways):
        owned = [blob for _, blob in way if blob is not None]
        if len(set(owned)) == len(owned):
            totals.append(sum(cost for cost, _ in way))
    return min(totals)


def total_cost(cells, of_cells):
    """The cost of an assignment: one cell at most has a blob of its own, the others share it."""
    total = 0.0
    for blob in set(of_cells):
        with_it = [i for i, other in enumerate(of_cells) if other == blob]
        if blob is None:
            total += NO_BLOB_COST * len(with_it)
            continue
        shared = [float(cells.shared_blob[i, blob]) for i in with_it]
        saved = [cost - cells.own_blob[i, blob] for cost, i in zip(shared, with_it, strict=True)]
        total += sum(shared) - max(0.0, *saved)
    return total


@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(1, 3))
def test_the_assignment_is_the_cheapest_of_all(seed, count, blobs):
    rng = np.random.default_rng(seed)
    own = rng.uniform(0, 120, (count, blobs)).clip(max=NO_BLOB_COST)
    shared = np.where(
        rng.random((count, blobs)) < 0.5, NO_BLOB_COST, rng.uniform(30, 90, (count, blobs))
    )
    cells = CellCosts(own, shared, np.zeros_like(own, dtype=bool))
    found = assign_blobs(cells, SpeckCosts(np.zeros((0, blobs)), np.zeros(0)))
    assert total_cost(cells, found.blob_of_cell) == pytest.approx(cheapest(cells))


def test_a_speck_gets_no_blob_of_a_cell_and_none_that_is_dearer_than_nothing():
    shared = np.full((1, 3), NO_BLOB_COST)
    cells = CellCosts(
        np.array([[5.0, NO_BLOB_COST, NO_BLOB_COST]]), shared, np.zeros((1, 3), dtype=bool)
    )
    specks = SpeckCosts(
        np.array([[1.0, 20.0, FORBIDDEN_COST], [FORBIDDEN_COST, FORBIDDEN_COST, 60.0]]),
        np.array([40.0, 50.0]),
    )
    found = assign_blobs(cells, specks)
    assert found.blob_of_cell == [0]
    assert found.blob_of_speck == [1, None]


def centres_of_mixture(starts, points):
    """The centres of two normal distributions of the cells' sizes, after rounds of EM."""
    sizes = np.diag([(LENGTH_UM / 4) ** 2, (WIDTH_UM / 4) ** 2])
    centres = [start[:2] for start in starts]
    for _ in range(EM_ITERATIONS):
        densities = []
        for centre, (_, _, axis) in zip(centres, starts, strict=True):
            turn = np.array([[math.cos(axis), -math.sin(axis)], [math.sin(axis), math.cos(axis)]])
            spread = stats.multivariate_normal(centre, turn @ sizes @ turn.T)
            densities.append(spread.logpdf(points))
        shares = np.exp(densities - np.logaddexp(*densities))
        centres = [np.average(points, axis=0, weights=share) for share in shares]
    return np.array(centres)


def test_two_cells_in_one_blob_are_found_at_its_two_ends():
    rng = np.random.default_rng(3)
    axes = np.array([0.4, 1.9])
    centres = np.array([[100.0, 100.0], [100.0 + 0.9 * LENGTH_UM, 110.0]])
    points = []
    for centre, axis in zip(centres, axes, strict=True):
        along = rng.normal(0, LENGTH_UM / 4, 2000)
        aside = rng.normal(0, WIDTH_UM / 4, 2000)
        cos, sin = math.cos(axis), math.sin(axis)
        points.append(
            centre + np.column_stack([along * cos - aside * sin, along * sin + aside * cos])
        )
    mixed = rng.permutation(np.concatenate(points))
    starts = np.column_stack([centres + np.array([[4.0, -4.0], [-4.0, 3.0]]), axes])
    owners = [cell_seen(), cell_seen()]
    found = find_centres_in_blob(owners, starts, mixed)
    assert found == pytest.approx(centres, abs=4.0)
    sampled = mixed[:: len(mixed) // EM_PIXELS_MAX]
    assert found == pytest.approx(centres_of_mixture(starts, sampled))
    swapped = find_centres_in_blob(owners, starts[::-1], mixed)
    assert swapped == pytest.approx(found[::-1])


def shared_cost(away_um, along=True, missed_s=0.0, scale=2.0):
    """The cost of a place `away_um` beyond the end of a long blob in columns 40 to 60, row 50."""
    size = SimpleNamespace(width=10.0, area_um2=CELL_UM2)
    cell = SimpleNamespace(size=size, missed_s=missed_s)
    columns = np.arange(40.0, 61.0)
    pixels = np.column_stack([columns, np.full(21, 50.0)])
    blob = SimpleNamespace(x=50.0, y=50.0, length=21.0, width=5.0 * scale, pixels=pixels)
    px = away_um / 2.0
    place = (60.0 + px, 50.0) if along else (50.0, 50.0 - px)
    return float(_compute_shared_costs([cell], np.array([place]), [blob], um_px=2.0)[0, 0])


@pytest.mark.parametrize("along", [True, False])
@pytest.mark.parametrize(("away_um", "is_shared"), [(0.0, True), (5.9, True), (6.1, False)])
def test_a_cell_shares_a_blob_within_a_part_of_its_width(away_um, is_shared, along):
    assert (shared_cost(away_um, along) < NO_BLOB_COST) is is_shared


def test_nothing_is_shared_without_blobs_or_without_cells():
    cell = SimpleNamespace(size=SimpleNamespace(width=5.0, area_um2=CELL_UM2), missed_s=0.0)
    assert _compute_shared_costs([cell], np.zeros((1, 2)), [], 1.0).shape == (1, 0)
    blob = SimpleNamespace(x=0.0, y=0.0, length=9.0, width=5.0, pixels=np.zeros((1, 2)))
    assert _compute_shared_costs([], np.zeros((0, 2)), [blob], 1.0).shape == (0, 1)


def test_a_new_speck_is_searched_farther_and_a_slow_image_rate_searches_farther():
    def reaches(count, share, passed_s):
        speck = speck_at(*((k * passed_s, 100.0) for k in range(count)))
        place = np.array([[100.0 + share * LENGTH_UM, 100.0, 0.0, LENGTH_UM, WIDTH_UM]])
        costs = compute_speck_costs([speck], place, count * passed_s, passed_s, ORGANISM)
        return costs.blobs[0, 0] < FORBIDDEN_COST

    usual_s = 1 / 30
    assert reaches(2, 0.75, usual_s) and not reaches(2, 0.8, usual_s)
    assert reaches(3, 0.47, usual_s) and not reaches(3, 0.5, usual_s)
    assert reaches(3, 0.94, 2 * usual_s) and not reaches(3, 1.0, 2 * usual_s)
    assert reaches(3, 0.47, usual_s / 4) and not reaches(3, 0.5, usual_s / 4)

"""Tests that organisms are found by name, with ordered ranges and sources."""

import math
import sys
from types import ModuleType

import pytest
from scipy.stats import norm
from tetractl_microscope.organisms import EUGLENA, PARAMECIUM, TETRAHYMENA, find_organism
from tetractl_microscope.registries import ORGANISMS

from tetractl.core.errors import UsageError
from tetractl.model.cell_numbers import BODY_LENGTH_UM, BODY_WIDTH_UM


@pytest.mark.parametrize("name", ORGANISMS.names())
def test_an_organism_found_by_name_has_ordered_ranges_and_a_source(name: str) -> None:
    organism = find_organism(name)
    assert organism.name == name
    assert 0 < organism.wide_um[0] < organism.wide_um[1] < organism.long_um[1]
    assert 0 < organism.slowest_um_s < organism.speed_um_s[0] < organism.speed_um_s[1]
    shortest, longest = organism.outline_um[0]
    assert shortest < organism.long_um[0] < organism.body_um[0] < longest
    assert (
        organism.outline_um2[0]
        < organism.body_um[0] * organism.body_um[1]
        < organism.outline_um2[1]
    )
    assert "doi:" in organism.source


def test_a_file_may_add_an_organism_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    mine = ModuleType("mine")
    vars(mine)["MINE"] = TETRAHYMENA
    monkeypatch.setitem(sys.modules, "mine", mine)
    monkeypatch.setitem(ORGANISMS.builtin, "mine", "mine:MINE")
    assert find_organism("mine") is TETRAHYMENA


@pytest.mark.parametrize(
    ("bounds", "body"),
    [(TETRAHYMENA.long_um, BODY_LENGTH_UM), (TETRAHYMENA.wide_um, BODY_WIDTH_UM)],
)
def test_about_19_of_20_bodies_are_within_the_ranges(
    bounds: tuple[float, float], body: tuple[float, float]
) -> None:
    low, high = norm(*body).cdf(bounds)
    assert high - low == pytest.approx(0.95, abs=0.01)
    assert low == pytest.approx(1 - high)


def test_quickness_counts_lengths_per_second_relative_to_tetrahymena() -> None:
    assert TETRAHYMENA.quickness == pytest.approx(1.0)
    lengths_per_s = 150.0 / 47.5
    tetrahymenas = 760.0 / BODY_LENGTH_UM[0]
    assert EUGLENA.quickness == pytest.approx(lengths_per_s / tetrahymenas)


def test_an_outline_may_be_longer_and_shorter_than_a_body_by_the_same_factor() -> None:
    bounds = PARAMECIUM.long_um, PARAMECIUM.wide_um
    for (low, high), (shortest, longest) in zip(bounds, PARAMECIUM.outline_um, strict=True):
        assert longest / high == pytest.approx(low / shortest)
        assert 1.3 < longest / high < 2.0


def test_the_area_of_an_outline_is_that_of_an_ellipse() -> None:
    (short, long), (thin, thick) = EUGLENA.outline_um
    assert EUGLENA.outline_um2[0] == pytest.approx(math.pi * (short / 2) * (thin / 2))
    assert EUGLENA.outline_um2[1] == pytest.approx(math.pi * (long / 2) * (thick / 2))


def test_a_body_is_in_the_middle_of_the_ranges_and_a_third_of_the_lowest_speed_is_rest() -> None:
    assert PARAMECIUM.body_um == (235.0, 50.0)
    assert PARAMECIUM.slowest_um_s == pytest.approx(500.0 / 3)


def test_an_unknown_organism_is_refused_with_the_known_ones() -> None:
    with pytest.raises(UsageError, match="no organism named 'amoeba'") as error:
        find_organism("amoeba")
    assert all(name in str(error.value) for name in ("tetrahymena", "paramecium", "euglena"))

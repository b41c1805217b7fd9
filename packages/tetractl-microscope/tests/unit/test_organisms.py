"""Organisms are found by name, and their ranges are ordered and say where they come from."""

import sys
from types import ModuleType

import pytest
from tetractl_microscope.organisms import TETRAHYMENA, named
from tetractl_microscope.registries import ORGANISMS


@pytest.mark.parametrize("name", ORGANISMS.names())
def test_an_organism_found_by_name_has_ordered_ranges_and_a_source(name: str) -> None:
    one = named(name)
    assert one.name == name
    assert 0 < one.wide_um[0] < one.wide_um[1] < one.long_um[1]
    assert 0 < one.slowest_um_s < one.speed_um_s[0] < one.speed_um_s[1]
    shortest, longest = one.outline_um[0]
    assert shortest < one.long_um[0] < one.body_um[0] < longest
    assert one.outline_um2[0] < one.body_um[0] * one.body_um[1] < one.outline_um2[1]
    assert "doi:" in one.source


def test_a_file_may_add_an_organism_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    mine = ModuleType("mine")
    vars(mine)["MINE"] = TETRAHYMENA
    monkeypatch.setitem(sys.modules, "mine", mine)
    monkeypatch.setitem(ORGANISMS.builtin, "mine", "mine:MINE")
    assert named("mine") is TETRAHYMENA

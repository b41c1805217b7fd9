"""Tests of the spec that `tetractl lab survey -o` writes, in any folder."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from tetractl_microscope.survey import _format_choice, _parse_micrometer, _rebase_file_names

from tetractl.core.errors import UsageError


def test_a_choice_with_a_cell_near_the_edge_says_so():
    """Regression: the best choice stood at the edge, and only the list of cells said so."""
    cells = [SimpleNamespace(number=3, free=True), SimpleNamespace(number=7, free=False)]
    proposal = SimpleNamespace(numbers=[3, 7], cells=cells, error=41.2)
    line = _format_choice(proposal, "um")
    assert line.startswith("cells 3, 7: predicted mean total error 41 um;")
    assert line.endswith("because of cells near the edge: 7")
    cells[1].free = True
    assert _format_choice(proposal, "um") == "cells 3, 7: predicted mean total error 41 um"


def test_a_spec_in_another_folder_names_the_same_files(tmp_path):
    """Regression: the calibration was searched next to the new spec."""
    data = {
        "identified": "../cells.yaml",
        "lab": {"calibration": "scale.yaml"},
        "plant": {"type": "sim"},
        "controller": None,
    }
    _rebase_file_names(data, tmp_path / "experiments", tmp_path / "trials")
    assert data["lab"]["calibration"] == str(Path("..") / "experiments" / "scale.yaml")
    assert data["identified"] == str(Path("..") / "cells.yaml")
    assert data["plant"] == {"type": "sim"}
    assert data["controller"] is None


def test_a_choice_without_a_plan_says_so_instead_of_an_error():
    proposal = SimpleNamespace(
        numbers=[3], cells=[SimpleNamespace(number=3, free=True)], error=1e999
    )
    assert _format_choice(proposal, "um").endswith("error unknown, because no plan was found")


def test_files_that_are_not_relative_names_are_kept(tmp_path):
    absolute = str(tmp_path / "scale.yaml")
    data = {
        "lab": {"calibration": absolute},
        "plant": {"faults": {"lost": 1}, "calibration": "a.yaml"},
        "controller": {"weights": "w.npz", "period": 0.2},
    }
    _rebase_file_names(data, tmp_path / "here", tmp_path / "there")
    assert (tmp_path / "there" / data["lab"]["calibration"]).resolve() == Path(absolute).resolve()
    assert data["plant"] == {"faults": {"lost": 1}, "calibration": str(Path("../here/a.yaml"))}
    assert data["controller"] == {"weights": str(Path("../here/w.npz")), "period": 0.2}


@pytest.mark.parametrize(
    ("text", "places"),
    [
        ("112,540,901,548,2000", ((112, 540), (901, 548), 2000)),
        ("0,0,-1.5,2e1,0.5", ((0, 0), (-1.5, 20), 0.5)),
    ],
)
def test_two_places_and_their_distance_are_read_in_this_order(text, places):
    assert _parse_micrometer(text) == places


@pytest.mark.parametrize(
    "text",
    [
        "1,2,3,4",
        "1,2,3,4,5,6",
        "1,2,3,4,um",
        "",
        "1,2,3,4,0",
        "1,2,3,4,-5",
        "1,2,3,4,inf",
        "nan,2,3,4,5",
        "1,2,inf,4,5",
        "1,2,3,4,nan",
    ],
)
def test_places_that_are_not_five_numbers_with_a_distance_are_refused(text):
    with pytest.raises(UsageError, match="give five numbers"):
        _parse_micrometer(text)

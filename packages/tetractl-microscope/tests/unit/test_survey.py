"""Tests of the spec that `tetractl lab survey -o` writes, in any folder."""

from pathlib import Path
from types import SimpleNamespace

from tetractl_microscope.survey import _choice_line, _keep_files


def test_a_choice_with_a_cell_near_the_edge_says_so():
    """Regression: the best choice stood at the edge, and only the list of cells said so."""
    cells = [SimpleNamespace(number=3, free=True), SimpleNamespace(number=7, free=False)]
    proposal = SimpleNamespace(numbers=[3, 7], cells=cells, error=41.2)
    line = _choice_line(proposal, "um")
    assert line.startswith("cells 3, 7: predicted mean total error 41 um;")
    assert line.endswith("because of cells near the edge: 7")
    cells[1].free = True
    assert _choice_line(proposal, "um") == "cells 3, 7: predicted mean total error 41 um"


def test_a_spec_in_another_folder_names_the_same_files(tmp_path):
    """Regression: the calibration was searched next to the new spec."""
    data = {
        "identified": "../cells.yaml",
        "lab": {"calibration": "scale.yaml"},
        "plant": {"type": "sim"},
        "controller": None,
    }
    _keep_files(data, tmp_path / "experiments", tmp_path / "trials")
    assert data["lab"]["calibration"] == str(Path("..") / "experiments" / "scale.yaml")
    assert data["identified"] == str(Path("..") / "cells.yaml")
    assert data["plant"] == {"type": "sim"}
    assert data["controller"] is None

"""`tetractl lab survey -o`: the spec that it writes, in any folder."""

from pathlib import Path

from tetractl_microscope.survey import _keep_files


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

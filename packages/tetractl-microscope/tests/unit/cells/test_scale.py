"""Tests of a microscope's scale from two places in its image."""

import math

import pytest
from testkit.cli import tetractl
from testkit.emulator.virtual_lab import DISH

from tetractl.spec.load import load_spec
from tetractl.spec.plants import apply_calibration, select_plant

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("rotation", [0.0, 0.3, -2.5])
def test_a_calibration_file_has_scale_and_rotation_and_places_the_two_as_measured(
    rotation, tmp_path
):
    um_px = 2.3
    um = 1000.0
    first = 700.0, 650.0
    # of the spec's x axis in the picture, y upwards
    long = um / um_px
    axis = -rotation
    second = first[0] + long * math.cos(axis), first[1] - long * math.sin(axis)
    places = ",".join(map(repr, (*first, *second, um)))
    out = tmp_path / "scale.yaml"
    done = tetractl(tmp_path, "lab", "survey", DISH, f"--micrometer={places}", "-o", out)
    assert done.returncode == 0, done.stderr
    assert "2.3000 um/px" in done.stdout
    loaded = select_plant(load_spec(DISH), "lab")
    camera = apply_calibration(loaded.experiment, out.read_text(), "scale.yaml").plant.camera
    assert camera.um_px == pytest.approx(um_px)
    assert camera.rotation == pytest.approx(rotation)
    start = camera.placed(first[0] * um_px, -first[1] * um_px, 1e-6)
    end = camera.placed(second[0] * um_px, -second[1] * um_px, 1e-6)
    assert end[0] - start[0] == pytest.approx(um)
    assert end[1] - start[1] == pytest.approx(0.0, abs=1e-6)

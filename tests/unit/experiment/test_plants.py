"""The experiment on the plant that will be run."""

from support.lab_specs import SPEC

from tetractl.core.poses import Sight
from tetractl.experiment.load import parse_spec
from tetractl.experiment.plants import on_plant
from tetractl.lab.cameras.optitrack.section import OptitrackSection


def test_the_setup_has_the_sight_of_the_camera_that_will_be_used(monkeypatch):
    """Regression: a setup computed before, for the simulation, stayed; `verify` saw another."""
    coarse = Sight(grid_mm=1.5)
    monkeypatch.setattr(OptitrackSection, "sight", coarse)
    loaded = parse_spec(SPEC, "spec.yaml", ["plant={type: sim}"])
    assert loaded.experiment.setup.sight == Sight()
    driven = on_plant(loaded, "lab").experiment
    assert driven.setup.sight == coarse
    assert loaded.experiment.setup.sight == Sight()

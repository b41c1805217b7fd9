import pytest
from support.paths import ROOT

from tetractl.experiment.load import load_spec
from tetractl.plant.sim_section import SimSection
from tetractl.run import task
from tetractl.run.task import run_trial


class OpenPlant:
    """Stands for a plant that is open when it is built, as one whose cells were chosen."""

    def __init__(self):
        self.calls = []

    def stop(self):
        self.calls.append("stop")

    def close(self):
        self.calls.append("close")


def test_robots_stop_and_the_plant_closes_if_no_controller_can_be_built(monkeypatch, tmp_path):
    """Regression: the field that showed which cells respond went on turning."""
    plant = OpenPlant()

    def fail(*args):
        raise ValueError("a plug-in's defect")

    monkeypatch.setattr(SimSection, "build", lambda *args: plant)
    monkeypatch.setattr(task, "build_controller", fail)
    with pytest.raises(ValueError, match="a plug-in's defect"):
        run_trial(load_spec(ROOT / "experiments/three_m3pi.yaml"), tmp_path)
    assert plant.calls == ["stop", "close"]

import pytest
from testkit.paths import ROOT

from tetractl.plant.sim_section import SimSection
from tetractl.run import spec_trial
from tetractl.run.spec_trial import run_logged
from tetractl.spec.load import load_spec


class OpenPlant:
    """Stands for a plant that is open when it is built, as one whose cells were chosen."""

    def __init__(self):
        self.calls = []

    def stop(self):
        self.calls.append("stop")

    def close(self):
        self.calls.append("close")


@pytest.mark.parametrize("part", ["build_controller", "start_of", "stated_model", "Trial"])
def test_robots_stop_and_the_plant_closes_if_a_part_of_the_trial_cannot_be_built(
    part, monkeypatch, tmp_path
):
    """Regression: the field that showed which cells respond went on turning."""
    plant = OpenPlant()

    def fail(*args, **fields):
        raise ValueError("a plug-in's defect")

    monkeypatch.setattr(SimSection, "build", lambda *args: plant)
    monkeypatch.setattr(spec_trial, part, fail)
    with pytest.raises(ValueError, match="a plug-in's defect"):
        run_logged(load_spec(ROOT / "experiments/three_m3pi.yaml"), tmp_path)
    assert plant.calls == ["stop", "close"]

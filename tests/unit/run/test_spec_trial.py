from pkgutil import resolve_name

import pytest
from testkit.paths import ROOT

from tetractl.core.registries import CONTROLLERS
from tetractl.log.read.reader import read_trial
from tetractl.plant.sim_section import SimSection
from tetractl.run import spec_trial
from tetractl.run.logged_trial import log_path, run_logged
from tetractl.run.model_changes import model_monitor
from tetractl.spec.controller import ControllerSection
from tetractl.spec.load import load_spec


class OpenPlant:
    """Stands for a plant that is open when it is built, as one whose cells were chosen."""

    def __init__(self):
        self.calls = []

    def stop(self):
        self.calls.append("stop")

    def close(self):
        self.calls.append("close")


@pytest.mark.parametrize("part", ["build_controller", "create_start", "_model_monitor", "Trial"])
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


@pytest.mark.parametrize("name", CONTROLLERS.builtin)
def test_controllers_that_estimate_the_motion_have_a_monitor_of_it(name):
    section = CONTROLLERS.load(name)
    estimates = "estimate" in section.model_fields
    assert section.model_monitor == (ControllerSection.model_monitor if estimates else "")
    assert resolve_name(ControllerSection.model_monitor) is model_monitor


@pytest.mark.long
def test_a_trial_reports_what_the_estimates_of_its_controller_show(tmp_path):
    """Blue sticks after 4 s: the filter finds that it stands, and the operator is informed."""
    sticking = "plant.disturbances=[{type: sticking, every: 20, duration: 100}]"
    settings = [sticking, "trials.seed=2", "controller.time_limit=7"]
    run_logged(load_spec(ROOT / "experiments/three_m3pi.yaml", settings), tmp_path)
    texts = [note.text for note in read_trial(log_path(tmp_path, 0)).notes]
    assert "blue stands still although it is sent a direction" in texts

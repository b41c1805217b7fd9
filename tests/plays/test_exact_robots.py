"""A trial of robots that obey and stop at once, before a camera without noise, in virtual time."""

from unittest import mock

from support.labs import fake_lab
from support.paths import ROOT

from tetractl.core.plan import Outcome, State
from tetractl.experiment.load import load_spec
from tetractl.experiment.plants import on_plant
from tetractl.log.read.reader import read_trial
from tetractl.plant.lab_plant import LabPlantSection
from tetractl.replay.verify import verify
from tetractl.run.task import log_path, run_trial

SPEC = ROOT / "experiments" / "three_m3pi_lab.yaml"


def test_a_trial_ends_at_the_first_rest_on_the_targets(tmp_path):
    spec = on_plant(load_spec(SPEC, ["controller.steps_max=240"]), "lab")
    lab = fake_lab(spec.experiment.setup)
    plant = {"build": lambda *_: lab.plant, "clock": lambda _: lab.clock}
    with mock.patch.multiple(LabPlantSection, **plant):
        result = run_trial(spec, tmp_path)
    log = read_trial(log_path(tmp_path, 0))
    assert (result.outcome, result.reason) == (Outcome.NOTHING_BETTER, "")
    assert result.total_error < 1
    assert [step.k for step in log.steps if step.plan.state is State.RESTING] == [result.steps - 1]
    verified = verify(log_path(tmp_path, 0))
    assert verified.ok, verified.problems

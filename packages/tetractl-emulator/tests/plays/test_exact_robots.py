"""Trials of robots that obey and stop at once, before a camera without noise, in virtual time."""

from unittest import mock

import pytest
from support.labs import fake_lab
from support.paths import ROOT

from tetractl.core.plan import Outcome, State
from tetractl.experiment.load import load_spec
from tetractl.experiment.plants import on_plant
from tetractl.log.read.reader import read_trial
from tetractl.plant.lab_plant import LabPlantSection
from tetractl.replay.verify import verify
from tetractl.run.spec_trial import log_path, run_logged

pytestmark = pytest.mark.slow

SPEC = ROOT / "experiments" / "three_m3pi_lab.yaml"


def driven(folder, *sets):
    """Run a trial; return its result and what its robots did in each step. Its log verifies."""
    spec = on_plant(load_spec(SPEC, sets), "lab")
    lab = fake_lab(spec.experiment.setup)
    plant = {"build": lambda *_: lab.plant, "clock": lambda _: lab.clock}
    with mock.patch.multiple(LabPlantSection, **plant):
        result = run_logged(spec, folder)
    verified = verify(log_path(folder, 0))
    assert verified.ok, verified.problems
    return result, [step.plan.state for step in read_trial(log_path(folder, 0)).steps]


@pytest.mark.long
def test_a_trial_ends_at_the_first_rest_on_the_targets(tmp_path):
    result, states = driven(tmp_path, "controller.time_limit=48.2")
    assert (result.outcome, result.reason) == (Outcome.NO_BETTER_PLAN, "")
    assert result.total_error < 1
    assert states.index(State.RESTING) == len(states) - 1


@pytest.mark.long
def test_a_trial_goes_on_after_a_turn_on_the_spot(tmp_path):
    """Regression: its guard ended it, and its log would not have verified."""
    before_an_obstacle = "robots.1.start=[1146, 1200]"
    result, states = driven(tmp_path, "controller.time_limit=24.2", before_an_obstacle)
    assert result.outcome.complete
    assert states[0] is State.TURNING
    assert State.DRIVING in states

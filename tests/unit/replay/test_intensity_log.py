"""A log whose controller chose the frequency of the field: kept, shown, and computed again."""

import numpy as np
import pytest
from support.paths import ROOT
from support.tampering import missed

from tetractl.api import to_arrays
from tetractl.core.errors import UsageError
from tetractl.experiment.load import load_spec
from tetractl.log.read.reader import read_trial
from tetractl.log.read.salvage import scan
from tetractl.replay.identification.tracks import track_of
from tetractl.replay.player import Recording
from tetractl.replay.verify import verify
from tetractl.results.trial_tables import steps
from tetractl.run.interrupt import Interrupt
from tetractl.run.task import log_path, run_trial
from tetractl.view.figures.draw import draw
from tetractl.view.terminal.replay_screen import step_line

pytestmark = pytest.mark.slow

SHORT = [
    "obstacles=[{type: circle, center: [500, 500], radius: 20}]",
    "controller.horizon_max=4",
    "controller.steps_max=5",
    "controller.dead_time=0.2",
    "plant.dead_time=0.2",
    "controller.optimizer={type: pso, particles: 9, iterations: 12}",
]


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rollers")
    run_trial(
        load_spec(ROOT / "experiments" / "two_rollers.yaml", SHORT), folder, 0, (), Interrupt()
    )
    return log_path(folder, 0)


def test_decisions_are_computed_again_to_the_bit(path):
    found = verify(path)
    assert (found.ok, found.problems) == (True, ())
    log = read_trial(path)
    for step in log.steps:
        assert step.plan.signals.shape == (step.plan.search.length, 2)
        assert step.command.intensity == step.plan.signals[0, 1]
        assert 0 <= step.plan.signals[0, 1] <= 80
    assert log.stop.intensity is None
    assert log.result.verdict.stood == ""  # a frequency far above a step-out moves a robot little


@pytest.mark.long
def test_another_frequency_is_noticed_anywhere(path):
    assert missed(path) == set()


def test_tables_arrays_lines_and_figures_show_it(path):
    log = read_trial(path)
    chosen = [step.command.intensity for step in log.steps]
    table = steps(log, scan(path)).as_dict()
    assert list(table["frequency_rad/s"]) == chosen
    assert to_arrays(log).intensity.tolist() == chosen
    assert f", {chosen[0]:.3g} rad/s" in step_line(Recording(log), 0)
    direction, frequency = draw("signal", [log]).axes
    assert np.asarray(frequency.lines[0].get_ydata()).tolist() == chosen
    assert frequency.get_ylabel() == "frequency [rad/s]"
    assert np.size(direction.lines[0].get_ydata()) == len(chosen)
    assert draw("swarm", [log]).axes


def test_no_turning_rate_is_identified_from_it(path):
    with pytest.raises(UsageError, match="its controller chose the frequency of the field"):
        track_of(read_trial(path))

"""The disc in which a robot is for 95 % of a hold, as a statistic with its interval."""

from dataclasses import replace

import numpy as np
import pytest
from support.paths import ROOT

from tetractl.api import read_batch, read_log, run_batch, to_arrays
from tetractl.experiment.load import load_spec
from tetractl.results.disc import DISC, discs

pytestmark = pytest.mark.slow
SETS = ("hold.time=7", "trials.count=3", "controller.optimizer.tolerance=2")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("holds")
    run_batch(load_spec(ROOT / "experiments/magnetospirillum_hold.yaml", SETS), made)
    return made


def test_the_disc_is_that_of_the_true_path_without_the_first_5_s(folder):
    log = read_log(folder / "trial-000.mcap")
    arrays, target = to_arrays(log), log.start.setup.targets[0]
    begun = next(s.observation.sampled_ns for s in log.steps if s.plan.leg == 1)
    late = arrays.time_s >= log.elapsed_s(begun) + 5
    gaps = np.linalg.norm(arrays.truth[late, 0, :2] - target, axis=1)
    assert 30 < late.sum() < 80  # 2 s at 30 Hz
    assert discs(log) == pytest.approx([2 * np.quantile(gaps, 0.95)])


def test_the_mean_has_an_interval_and_a_trial_its_own(folder):
    trials = read_batch(folder).trials
    ours = [DISC.of_trial(trial)["disc_bacterium"] for trial in trials]
    (value,) = DISC.of_batch(trials)
    assert value.number.distribution.mean == pytest.approx(np.mean(ours))
    interval = value.number.distribution.ci95
    assert interval.low < np.mean(ours) < interval.high
    assert value.label == "diameter of the disc of 95 % of the hold (disc_bacterium), mean [um]"


def test_without_a_hold_or_a_whole_log_there_is_none(folder):
    (trial, *_) = read_batch(folder).trials
    assert DISC.of_trial(replace(trial, brief=True)) == {"disc_bacterium": None}
    short = trial.experiment.model_copy(update={"hold": None})
    assert not DISC.of_trial(replace(trial, experiment=short))

"""Tests of the disc that holds a robot for 95 % of a hold, as a statistic with its interval."""

import numpy as np
import pytest
from testkit.paths import ROOT

from tetractl import read_batch, read_log, run_batch, to_arrays
from tetractl.spec.load import load_spec
from tetractl.statistics.built_in_statistics import DISC, discs

pytestmark = [pytest.mark.slow, pytest.mark.long]  # the trials of its fixture
HOLD_S = 7
START_LEFT_OUT_S = 5  # of each hold
CAMERA_HZ = 30
SETS = (f"hold.time={HOLD_S}", "trials.count=3", "controller.optimizer.tolerance=2")


@pytest.fixture(scope="module")
def holds(tmp_path_factory):
    """The folder of three trials that hold one cell."""
    folder = tmp_path_factory.mktemp("holds")
    run_batch(load_spec(ROOT / "experiments/magnetospirillum_hold.yaml", SETS), folder)
    return folder


def test_the_disc_is_that_of_the_true_path_without_the_first_5_s(holds):
    log = read_log(holds / "trial-000.mcap")
    arrays = to_arrays(log)
    hold_began_ns = next(step.observation.sampled_ns for step in log.steps if step.plan.leg == 1)
    late = arrays.time_s >= log.elapsed_s(hold_began_ns) + START_LEFT_OUT_S
    assert late.sum() == pytest.approx((HOLD_S - START_LEFT_OUT_S) * CAMERA_HZ, abs=20)
    target = log.start.setup.targets[0]
    distances = np.linalg.norm(arrays.truth[late, 0, :2] - target, axis=1)
    assert discs(log) == pytest.approx([2 * np.quantile(distances, 0.95)])


def test_the_mean_has_an_interval_and_a_trial_its_own(holds):
    trials = read_batch(holds).trials
    diameters = [DISC.of_trial(trial)["disc_bacterium"] for trial in trials]
    (figure,) = DISC.of_batch(trials)
    mean = figure.items["disc_bacterium"]
    assert mean["mean"] == pytest.approx(np.mean(diameters))
    low, high = mean["ci95"]
    assert low < np.mean(diameters) < high
    assert figure.label == "diameter of the disc of 95 % of the hold (disc_bacterium), mean [um]"

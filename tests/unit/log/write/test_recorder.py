import pytest
from support.paths import ROOT

from tetractl.experiment.load import load_spec
from tetractl.log.format.trial_digest import trial_digest
from tetractl.log.read.reader import read_result, read_trial
from tetractl.log.write.recorder import Recorder
from tetractl.log.write.writer import LogWriter
from tetractl.run.interrupt import Interrupt
from tetractl.run.task import log_path, run_with


@pytest.mark.slow
@pytest.mark.parametrize("name", ["round_obstacle", "three_m3pi_bench", "tetrahymena_bench"])
def test_a_trial_has_the_same_digest_with_a_log_and_without(tmp_path, name):
    spec = load_spec(ROOT / "experiments" / f"{name}.yaml", ["controller.steps_max=12"])
    alone, beside, path = Recorder(), Recorder(), log_path(tmp_path, 3)
    result = run_with([alone], spec, 3, (), Interrupt())
    with LogWriter(path) as written:
        again = run_with([beside, written], spec, 3, (), Interrupt())
    assert again.robot_errors == result.robot_errors
    assert alone.trial_digest == beside.trial_digest == trial_digest(read_trial(path))
    assert alone.warnings == beside.warnings == read_result(path).warnings

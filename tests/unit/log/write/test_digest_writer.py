import pytest
from support.paths import ROOT

from tetractl.experiment.load import load_spec
from tetractl.log.read.reader import content_digest, read_result
from tetractl.log.write.digest_writer import DigestWriter
from tetractl.log.write.writer import LogWriter
from tetractl.run.batch import log_path, run_with
from tetractl.run.interrupt import Interrupt


@pytest.mark.slow
@pytest.mark.parametrize("name", ["round_obstacle", "three_m3pi_bench"])
def test_the_digest_without_a_log_is_that_of_the_log(tmp_path, name):
    spec = load_spec(ROOT / "experiments" / f"{name}.yaml", ["controller.steps_max=12"])
    weighed, path = DigestWriter(), log_path(tmp_path, 3)
    result = run_with(weighed, spec, 3, (), Interrupt())
    with LogWriter(path) as written:
        assert run_with(written, spec, 3, (), Interrupt()).robot_errors == result.robot_errors
    assert weighed.digest == written.digest == content_digest(path)
    assert weighed.warnings == written.warnings == read_result(path).warnings
    assert weighed.failure is None

"""What `verify` notices of a log tampered with in any channel, record or field."""

import pytest
from support.mutate import rewrite, rewritten, stating
from support.tampering import missed, sim_log

from tetractl.log.format.channels import RUN
from tetractl.log.read.salvage import scan
from tetractl.replay.verify import verify

pytestmark = pytest.mark.long

SHORT = ("controller.time_limit=0.8", "controller.horizon_max=5")


def test_a_simulation_is_noticed_to_be_tampered_with_anywhere(tmp_path):
    log = sim_log(tmp_path, SHORT)
    assert missed(log) == set()


@pytest.mark.parametrize("in_order", [True, False])
def test_a_log_that_another_program_wrote_anew_is_no_failure(tmp_path, in_order):
    log = sim_log(tmp_path, SHORT)
    found = verify(rewritten(log, tmp_path / "again.mcap", in_order, chunk_size=5000))
    assert (found.problems, found.rewritten[:4]) == ((), "mcap")
    assert bool(found.notes) != in_order  # on the digest, which is of another order
    shorter = rewrite(scan(log), tmp_path / "changed.mcap", stating(scan(log), RUN, seed=8))
    assert verify(rewritten(shorter, tmp_path / "changed-again.mcap", in_order)).problems

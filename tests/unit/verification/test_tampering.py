"""Tests of what `verify` notices in a log that was changed in any channel, record or field."""

import pytest
from testkit.mutate import rewrite, rewritten, stating
from testkit.tampering import missed, sim_log

from tetractl.log.format.channels import RUN
from tetractl.log.read.salvage import scan
from tetractl.verification.verify import verify

pytestmark = pytest.mark.long

SHORT = ("controller.time_limit=0.4", "controller.horizon_max=5")


def test_a_simulation_is_noticed_to_be_tampered_with_anywhere(tmp_path):
    log = sim_log(tmp_path, SHORT)
    assert missed(log) == set()


@pytest.mark.parametrize("in_order", [True, False])
def test_a_log_that_another_program_wrote_anew_is_still_checked(tmp_path, in_order):
    contents = scan(sim_log(tmp_path, SHORT))
    other_seed = stating(contents, RUN, seed=8)
    changed = rewrite(contents, tmp_path / "changed.mcap", other_seed)
    assert verify(rewritten(changed, tmp_path / "changed-again.mcap", in_order)).problems

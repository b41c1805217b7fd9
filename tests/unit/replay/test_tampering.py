"""What `verify` notices of a log tampered with in any channel, record or field."""

import pytest
from support.mutate import of_host, rewrite, rewritten, stating
from support.tampering import lab_log, score, sim_log, unnoticed_in_file

from tetractl.log.format import channels
from tetractl.log.format.channels import RUN
from tetractl.log.read.salvage import scan
from tetractl.replay.verify import verify

pytestmark = pytest.mark.slow

STATED_ONCE = {
    (channels.RUN, "spec_name"),
    (channels.SPEC, "text"),
    (channels.ENVIRONMENT, "text"),
    (channels.HOST_END, "ended"),
}
"""What nothing else in a log repeats, apart from the record of the host."""

ONLY_THE_LAB_KNOWS = {
    (channels.RUN, None),  # the facts of its devices
    (channels.COMMANDS, None),  # those between two control steps
    (channels.LOG, "message"),  # of a note while the trial runs
    (channels.RESULT, "clearance"),  # to a millionth: from other frames than are logged
    (channels.RESULT, "edge"),
    (channels.RESULT, "apart"),
    (channels.RESULT, "turn"),  # of the guard, from every frame
    (channels.RESULT, "turn_std"),
}


SHORT = ("controller.steps_max=3", "controller.horizon_max=5")
SMALL = (  # 5 Hz, few steps and a small swarm
    "controller.steps_max=4",
    "controller.period=0.2",
    "controller.signal_periods=1",
    "controller.deadline=0.15",
    "controller.optimizer={type: pso, particles: 6, iterations: 14}",
)


def missed(path):
    assert verify(path).problems == ()
    seen, tried = score(path, 1)
    assert {channel for channel, _ in tried} >= (
        channels.CHANNELS.keys() - {*channels.PICTURES, channels.DIGESTS, channels.RECOVERED}
    )
    return {
        kind for kind in tried if seen[kind] < tried[kind] and kind[0] != channels.HOST
    } - STATED_ONCE


def test_a_simulation_is_noticed_to_be_tampered_with_anywhere(tmp_path):
    log = sim_log(tmp_path, SHORT)
    assert missed(log) == set()
    assert unnoticed_in_file(log, tmp_path) == set()
    # of other versions of the libraries, the index is not compared
    other = rewrite(scan(log), tmp_path / "elsewhere.mcap", of_host(scan(log), mcap="0.1"))
    assert verify(other).ok
    assert {what for what in unnoticed_in_file(other, tmp_path) if "index" not in what} == set()


@pytest.mark.parametrize("in_order", [True, False])
def test_a_log_that_another_program_wrote_anew_is_no_failure(tmp_path, in_order):
    log = sim_log(tmp_path, SHORT)
    found = verify(rewritten(log, tmp_path / "again.mcap", in_order, chunk_size=5000))
    assert (found.problems, found.rewritten[:4]) == ((), "mcap")
    assert bool(found.notes) != in_order  # on the digest, which is of another order
    shorter = rewrite(scan(log), tmp_path / "changed.mcap", stating(scan(log), RUN, seed=8))
    assert verify(rewritten(shorter, tmp_path / "changed-again.mcap", in_order)).problems


@pytest.mark.system
def test_of_a_lab_only_what_it_alone_knows_can_be_changed(tmp_path):
    found = missed(lab_log(tmp_path, SMALL))
    assert {kind for kind in found if not {kind, (kind[0], None)} & ONLY_THE_LAB_KNOWS} == set()

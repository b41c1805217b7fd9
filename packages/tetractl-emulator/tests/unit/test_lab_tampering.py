"""What `verify` notices of the log of a lab tampered with in any channel, record or field."""

import pytest
from support.lab_logs import lab_log
from support.tampering import missed

from tetractl.log.format import channels

pytestmark = pytest.mark.system

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
SMALL = (  # 5 Hz, few steps and a small swarm
    "controller.time_limit=1",
    "controller.period=0.2",
    "controller.signal_periods=1",
    "controller.deadline=0.15",
    "controller.optimizer={type: pso, particles: 6, iterations: 14}",
)


def test_of_a_lab_only_what_it_alone_knows_can_be_changed(tmp_path):
    found = missed(lab_log(tmp_path, SMALL))
    assert {kind for kind in found if not {kind, (kind[0], None)} & ONLY_THE_LAB_KNOWS} == set()

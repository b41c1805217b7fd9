"""What `verify` notices of a log tampered with in any channel, record or field."""

import pytest
from support.tampering import lab_log, score, sim_log

from tetractl.log.format import channels
from tetractl.replay.verify import verify

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
    (channels.RESULT, "duration_s"),
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
        channels.CHANNELS.keys() - {*channels.FILM, channels.DIGESTS, channels.RECOVERED}
    )
    return {
        kind for kind in tried if seen[kind] < tried[kind] and kind[0] != channels.HOST
    } - STATED_ONCE


def test_a_simulation_is_noticed_to_be_tampered_with_anywhere(tmp_path):
    assert missed(sim_log(tmp_path, SHORT)) == set()


@pytest.mark.system
def test_of_a_lab_only_what_it_alone_knows_can_be_changed(tmp_path):
    found = missed(lab_log(tmp_path, SMALL))
    assert {kind for kind in found if not {kind, (kind[0], None)} & ONLY_THE_LAB_KNOWS} == set()

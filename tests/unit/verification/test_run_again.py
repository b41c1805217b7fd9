"""Tests of which trials `verify` may run again, and of how it stops one that takes too long."""

from dataclasses import replace

import pytest
from testkit.paths import ROOT
from testkit.trials import three_robots

from tetractl.core.plan import Outcome, StopReason
from tetractl.log.format.channels import Entry
from tetractl.log.provenance import TRIAL_CODE_KEY
from tetractl.run.task import code_hash
from tetractl.spec.load import load_spec
from tetractl.spec.plants import select_plant
from tetractl.verification.run_again import RecordCollector, why_not_again

pytestmark = pytest.mark.slow

NOT_SIMULATED = "it is not a simulation in virtual time"
ELSEWHERE = "it was written on another computer, or by other code"


@pytest.fixture(scope="module")
def log():
    return three_robots()


def with_plant(log, **fields):
    return replace(log, start=replace(log.start, plant=replace(log.start.plant, **fields)))


def with_spec_of_a_lab(log):
    lab = select_plant(load_spec(ROOT / "experiments" / "three_m3pi_lab.yaml"), "lab")
    return replace(log, experiment=lab.experiment)


def searched(log, stopped):
    """The log with one search of its last step ended by this reason."""
    *steps, last = log.steps
    *searches, search = last.plan.searches
    plan = replace(last.plan, searches=(*searches, replace(search, stopped=stopped)))
    return replace(log, steps=(*steps, replace(last, plan=plan)))


def test_a_simulation_in_virtual_time_of_this_code_on_this_computer_is_run_again(log):
    assert log.facts[TRIAL_CODE_KEY] == code_hash(log.experiment)
    assert why_not_again(log, ()) == ""
    for stopped in StopReason:
        if stopped is not StopReason.DEADLINE:
            assert why_not_again(searched(log, stopped), ()) == ""


def test_every_reason_alone_keeps_a_trial_from_being_run_again(log):
    assert why_not_again(with_plant(log, simulated=False), ()) == NOT_SIMULATED
    assert why_not_again(with_spec_of_a_lab(log), ()) == NOT_SIMULATED
    assert why_not_again(replace(log, result=None), ()) == NOT_SIMULATED
    assert why_not_again(log, ("machine: another",)) == ELSEWHERE
    assert why_not_again(replace(log, facts=log.facts | {TRIAL_CODE_KEY: "older"}), ()) == ELSEWHERE
    assert why_not_again(replace(log, facts={}), ()) == ELSEWHERE
    interrupted = replace(log.result, outcome=Outcome.INTERRUPTED)
    assert why_not_again(replace(log, result=interrupted), ()) == "it was interrupted"
    cut_short = searched(log, StopReason.DEADLINE)
    assert why_not_again(cut_short, ()) == "a deadline ended one of its searches"


def test_an_aborted_simulation_is_run_again(log):
    aborted = replace(log.result, outcome=Outcome.ABORTED)
    assert why_not_again(replace(log, result=aborted), ()) == ""


def test_a_recorder_keeps_every_record_and_asks_once_to_stop_when_its_time_is_over(monkeypatch):
    now_s = 0.0
    monkeypatch.setattr("tetractl.verification.run_again.computing_s", lambda: now_s)
    recorder = RecordCollector(deadline_s=5.0)
    records = [Entry("/log", i, i, b"") for i in range(4)]
    now_s = 5.0
    recorder.add(records[0])
    assert not recorder.is_late
    assert not recorder.interrupt.requested
    now_s = 5.1
    for record in records[1:]:
        recorder.add(record)
        assert recorder.is_late
        assert recorder.interrupt.count == 1
    assert recorder.records == records

"""Tasks of a batch: one trial each, with the log that is asked for."""

from dataclasses import replace

import pytest
from support.paths import ROOT

from tetractl.core.protocols import LabSupervision
from tetractl.experiment.load import load_spec
from tetractl.run import spec_trial
from tetractl.run import task as task_module
from tetractl.run.interrupt import Interrupt
from tetractl.run.task import batch_tasks, run_task


def first_task(spec, brief, monkeypatch):
    """The first task of a spec, for which nothing is compiled."""
    monkeypatch.setattr(task_module, "warm_up", lambda *args: None)
    (task,) = batch_tasks(spec, [0])
    return replace(task, brief=brief)


@pytest.mark.parametrize("brief", [False, True])
def test_who_supervises_a_task_supervises_its_plant_whatever_its_log(brief, monkeypatch, tmp_path):
    supervisions = []

    def fail(spec, clock, seed, supervision):
        supervisions.append(supervision)
        raise ValueError("no plant")

    monkeypatch.setattr(spec_trial, "_spec_and_plant", fail)
    spec = load_spec(ROOT / "experiments/three_m3pi.yaml")
    task = first_task(spec, brief, monkeypatch)
    supervision = LabSupervision()
    with pytest.raises(ValueError, match="no plant"):
        run_task(task, tmp_path, Interrupt(), (), supervision)
    assert supervisions == [supervision]

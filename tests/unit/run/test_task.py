"""Tests of trials in a form that any process can run, and of whose code may run them."""

import pickle

import pytest
from testkit.running import QUICK

from tetractl.run import task
from tetractl.run.interrupt import Interrupt
from tetractl.run.logged_trial import log_path
from tetractl.run.task import OtherCodeError, Task, batch_tasks, code_hash, run_task
from tetractl.spec.load import parse_spec

SPEC = parse_spec(QUICK, "quick.yaml")


def test_a_batch_has_a_task_for_each_trial_that_is_asked_for():
    tasks = batch_tasks(SPEC, [2, 0])
    assert [(one.trial, one.trial_count, one.key) for one in tasks] == [
        (2, SPEC.experiment.trials.count, ("", 2)),
        (0, SPEC.experiment.trials.count, ("", 0)),
    ]
    assert pickle.loads(tasks[0].spec).experiment == SPEC.experiment


@pytest.mark.parametrize(("code", "runs"), [("", True), ("same", True), ("another", False)])
def test_only_the_code_of_the_task_runs_it_and_no_code_means_any(tmp_path, code, runs):
    stated = code_hash(SPEC.experiment) if code == "same" else code
    one = Task(1, 3, pickle.dumps(SPEC), "arm", stated)
    if runs:
        finished = run_task(one, tmp_path, Interrupt())
        assert finished.result.steps > 0
        assert log_path(tmp_path, 1).exists()
        return
    with pytest.raises(OtherCodeError, match="the code of tetractl on the worker differs"):
        run_task(one, tmp_path, Interrupt())
    assert list(tmp_path.iterdir()) == []


def test_the_wall_time_does_not_count_loading_and_compiling(tmp_path, monkeypatch):
    now_s = 10.0
    monkeypatch.setattr(task.time, "perf_counter", lambda: now_s)

    def prepared(spec, code):
        nonlocal now_s
        now_s += 90
        return SPEC

    def run_logged(*_):
        nonlocal now_s
        now_s += 2

    monkeypatch.setattr(task, "_load_spec", prepared)
    monkeypatch.setattr(task, "run_logged", run_logged)
    assert run_task(Task(0, 1, b""), tmp_path, Interrupt()).wall_s == 2.0

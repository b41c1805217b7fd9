"""Tests of the arms of a paper: which trials are run, with which specs, and what comes back."""

from types import SimpleNamespace

import numpy as np
import pytest
from tetractl_papers import trials as papers_trials
from tetractl_papers.paper import Paper, Runs, Work
from tetractl_papers.trials import SEED, run_arms

from tetractl.run.logged_trial import log_path
from tetractl.spec.examples import find_examples

SPECS = find_examples()


class FakeBatches:
    """Stands for the runs of batches: remembers each, and gives logs that know their paths."""

    def __init__(self, monkeypatch):
        self.runs = []
        self.told = []
        monkeypatch.setattr(papers_trials, "read_trial", self.read)

    def __call__(self, spec, folder):
        self.runs.append((folder, spec.experiment))

    def read(self, path):
        signals = np.array([0.25, len(str(path.parent.name))])
        step = SimpleNamespace(plan=SimpleNamespace(signals=signals))
        later = SimpleNamespace(plan=SimpleNamespace(signals=np.array([9.0])))
        controller = SimpleNamespace(period=0.4)
        experiment = SimpleNamespace(controller=controller)
        return SimpleNamespace(path=path, steps=[step, later], experiment=experiment)

    def run(self, arms, folder, trials=None):
        paper = Paper("x", arms, [])
        return run_arms(paper, folder, SPECS, trials, self, self.told.append)


@pytest.fixture
def batches(monkeypatch):
    return FakeBatches(monkeypatch)


def paths(logs):
    return [log.path for log in logs]


def test_an_arm_is_a_batch_of_its_spec_in_a_folder_of_its_own(batches, tmp_path):
    arms = {"quick": Runs("single_cell", ("controller.time_limit=7",), 3)}
    results = batches.run(arms, tmp_path)
    ((folder, spec),) = batches.runs
    assert folder == tmp_path / "quick"
    assert (spec.trials.count, spec.trials.seed) == (3, SEED)
    assert spec.controller.time_limit == 7
    assert paths(results["quick"]) == [log_path(folder, trial) for trial in range(3)]
    (told,) = batches.told
    assert "3 trials of single_cell" in told


def test_the_user_may_ask_for_another_number_of_trials(batches, tmp_path):
    called = []

    def once(seed, number):
        called.append((seed, number))
        return {"value": number}

    arms = {"quick": Runs("single_cell", trials=3), "computed": Work(once, 4)}
    results = batches.run(arms, tmp_path, trials=2)
    assert [spec.trials.count for _, spec in batches.runs] == [2]
    assert len(results["quick"]) == 2
    assert results["computed"] == [{"value": 0}, {"value": 1}]
    assert called == [(SEED, 0), (SEED, 1)]
    assert len(batches.run(arms, tmp_path)["computed"]) == 4


def test_a_plan_is_sent_open_loop_in_all_trials_of_an_arm(batches, tmp_path):
    arms = {"planned": Runs("single_cell", trials=2), "sent": Runs("single_cell", (), 3, "planned")}
    results = batches.run(arms, tmp_path)
    folder, spec = batches.runs[1]
    assert folder == tmp_path / "sent"
    assert spec.controller.type == "sequence"
    assert spec.controller.period == 0.4
    assert list(spec.controller.directions) == [0.25, len("planned")]  # of step 0
    assert spec.trials.count == 3
    assert len(results["sent"]) == 3


def test_each_plan_is_sent_in_a_trial_of_its_own(batches, tmp_path):
    arms = {
        "planned": Runs("single_cell", trials=3),
        "sent": Runs("single_cell", ("plant.dead_time=0.1",), 2, plans_of="planned"),
    }
    results = batches.run(arms, tmp_path)
    runs = batches.runs[1:]
    folders = [tmp_path / "sent" / f"plan-00{i}" for i in range(2)]
    assert [folder for folder, _ in runs] == folders
    assert {spec.controller.type for _, spec in runs} == {"sequence"}
    assert {spec.plant.dead_time for _, spec in runs} == {0.1}
    assert {spec.trials.count for _, spec in runs} == {1}
    assert paths(results["sent"]) == [log_path(folder, 0) for folder in folders]

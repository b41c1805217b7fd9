"""Tests of running a study: which trials are run again, and the contents of logs and tables."""

import pickle
import shutil

import pytest
from testkit.studies import FAILING, SMALL, Watcher, run

from tetractl.core.errors import TetractlError, UsageError
from tetractl.run import logged_trial, store
from tetractl.run.batch import OnFailure, run_batch
from tetractl.run.executors import InProcessExecutor
from tetractl.run.interrupt import Interrupt
from tetractl.run.logged_trial import log_path
from tetractl.run.store import Store
from tetractl.run.task import batch_tasks

ARM = "dead_time=0.1"
OTHER_ARM = "dead_time=0"
TRIALS = 3  # of each of these two arms of SMALL


@pytest.fixture(scope="module")
def finished_folder(tmp_path_factory):
    return tmp_path_factory.mktemp("finished")


@pytest.fixture(scope="module")
def finished(finished_folder):
    """What the small study ran."""
    return run(finished_folder, SMALL)


@pytest.fixture
def done(tmp_path, finished_folder, finished):
    """A copy of its folder: the study and all that it left in `out`, logs too."""
    shutil.copytree(finished_folder, tmp_path, dirs_exist_ok=True)
    return tmp_path


def table_of(folder):
    return (folder / "out" / "trials.csv").read_bytes()


def test_trials_come_first_over_all_arms(finished):
    arms = [arm.name for arm in finished.loaded.arms]
    assert finished.watcher.started == [(arm, trial) for trial in range(TRIALS) for arm in arms]
    assert finished.watcher.endings[-1].remaining_s == 0
    assert finished.counts == (2 * TRIALS, 0, 0)


def test_trials_of_outdated_code_are_named_and_stay(done, monkeypatch):
    before = table_of(done)
    monkeypatch.setattr(store, "code_hash", lambda experiment: "newer")
    ran = run(done, SMALL)
    assert ran.tasks == []
    assert ran.outdated == {OTHER_ARM: TRIALS, ARM: TRIALS}
    assert table_of(done) == before


def test_trials_of_outdated_code_are_run_again_on_demand(done, monkeypatch):
    before = table_of(done)
    monkeypatch.setattr(store, "code_hash", lambda experiment: "newer")
    ran = run(done, SMALL, rerun_outdated=True)
    assert len(ran.tasks) == 2 * TRIALS
    assert ran.outdated == {}
    assert table_of(done) == before
    set_aside = {path.name for path in (done / "out" / ARM).glob("*attempt*")}
    assert set_aside == {f"trial-00{i}.attempt-1.mcap" for i in range(TRIALS)}


def test_more_trials_and_values_are_added_to_those_there_are(done):
    four_trials = SMALL.replace("count: 3", "count: 4")
    four_trials_three_arms = four_trials.replace("[0, 0.1]", "[0, 0.05, 0.1]")
    ran = run(done, four_trials_three_arms)
    assert len(ran.tasks) == 3 * 4 - 2 * TRIALS
    assert len(ran.finished) == 3 * 4


def test_trials_whose_logs_are_damaged_or_gone_are_run_again(done):
    before = table_of(done)
    log_path(done / "out" / ARM, 1).unlink()
    torn = log_path(done / "out" / ARM, 2)
    torn.write_bytes(torn.read_bytes()[:-300])
    ran = run(done, SMALL)
    assert [task.key for task in ran.tasks] == [(ARM, 1), (ARM, 2)]
    assert table_of(done) == before


def test_the_log_of_another_arm_is_refused(done):
    foreign = log_path(done / "out" / OTHER_ARM, 1)
    log_path(done / "out" / ARM, 1).write_bytes(foreign.read_bytes())
    with pytest.raises(
        UsageError, match=r"trial-001.mcap: this trial was run with another spec or seed"
    ):
        run(done, SMALL)


def run_as_batch(folder, spec, trials):
    """Run trials of a spec as a batch of their own in a folder."""
    batch = Store.of_batch(folder, spec.experiment)
    executor = InProcessExecutor(Interrupt())
    with batch.opened(resume=False):
        run_batch(batch_tasks(spec, trials), batch, executor, Watcher(), on_failure=OnFailure.END)


def test_batches_are_arms_of_a_study_that_lacks_their_other_trials(done, finished):
    for arm in finished.loaded.arms:
        run_as_batch(done / "batches" / arm.name, arm.spec, [0, 2])
    ran = run(done, SMALL, out="batches")
    assert sorted(task.key for task in ran.tasks) == [(OTHER_ARM, 1), (ARM, 1)]
    assert ran.outdated == {}
    assert (done / "batches" / "trials.csv").read_bytes() == table_of(done)


def test_a_trial_without_an_outcome_is_run_again_the_next_time(tmp_path, monkeypatch):
    ready_trial = logged_trial.ready_trial

    def ready_unless_trial_1(spec, trial, *more):
        if trial == 1:
            raise TetractlError("the disk is full")
        return ready_trial(spec, trial, *more)

    monkeypatch.setattr(logged_trial, "ready_trial", ready_unless_trial_1)
    ran = run(tmp_path, SMALL)
    assert ran.counts == (4, 2, 0)
    assert {why for *_, why in ran.watcher.failures} == {"the disk is full"}
    monkeypatch.undo()
    assert len(run(tmp_path, SMALL).tasks) == 2


class InterruptingObserver:
    """Stands for a user who interrupts a trial at its first step: observes all, asks then."""

    def __init__(self, interrupt):
        self._interrupt = interrupt

    def __getattr__(self, event):
        if event == "on_step":
            return lambda *args: self._interrupt.request()
        return lambda *args: None


def test_an_interrupted_trial_is_run_again_and_its_log_set_aside(tmp_path):
    interrupt = Interrupt()
    executor = InProcessExecutor(interrupt, [InterruptingObserver(interrupt)])
    ran = run(tmp_path, SMALL, executor=executor)
    assert ran.report.interrupted
    assert ran.counts == (1, 0, 5)
    assert ran.finished == {}
    assert len(list(tmp_path.rglob("trial-000.mcap"))) == 1
    again = run(tmp_path, SMALL)
    assert len(again.tasks) == 2 * TRIALS
    assert len(list(tmp_path.rglob("trial-000.attempt-1.mcap"))) == 1


def test_an_aborted_trial_is_finished_only_for_the_code_that_aborts_it(tmp_path, monkeypatch):
    assert len(run(tmp_path, FAILING).report.aborted) == 4
    assert run(tmp_path, FAILING).tasks == []
    monkeypatch.setattr(store, "code_hash", lambda experiment: "mended")
    assert len(run(tmp_path, FAILING).tasks) == 4


def test_a_study_of_another_spec_is_not_mixed_in(done):
    with pytest.raises(UsageError, match="another spec or seed"):
        run(done, SMALL.replace("seed: 7", "seed: 8"))


def test_an_arm_is_a_batch_that_can_be_resumed_and_not_overwritten(done, finished):
    arm = finished.loaded.arms[1]
    assert arm.name == ARM
    batch = Store.of_batch(done / "out" / ARM, arm.spec.experiment)
    batch.read()
    assert batch.unfinished == []
    with pytest.raises(UsageError, match="holds logs already"):
        batch.read(resume=False)


def test_the_specs_of_tasks_are_those_of_the_arms(tmp_path):
    ran = run(tmp_path, SMALL)
    arms = {arm.name: arm for arm in ran.loaded.arms}
    for arm_task in ran.tasks:
        assert pickle.loads(arm_task.spec).experiment == arms[arm_task.arm].spec.experiment

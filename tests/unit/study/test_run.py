import pickle
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from support.studies import FAILING, SMALL, Watcher, run

from tetractl.core.errors import TetractlError, UsageError
from tetractl.experiment.load import parse_spec
from tetractl.log.read.reader import content_digest, read_result
from tetractl.run import spec_trial, store, task
from tetractl.run.batch import run_batch
from tetractl.run.executors import Here
from tetractl.run.interrupt import Interrupt
from tetractl.run.spec_trial import log_path, run_trial
from tetractl.run.store import Store
from tetractl.run.task import OtherCodeError, batch_tasks
from tetractl.study.options import Logs

ALL, NONE = Logs(float("inf"), True), Logs(0, False)
ARM = "dead_time=0.1"


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A folder with the small study and all it leaves in `out`, logs too; what it ran."""
    folder = tmp_path_factory.mktemp("finished")
    return folder, run(folder, SMALL, logs=ALL)


@pytest.fixture
def done(tmp_path, finished):
    """A copy of that folder."""
    shutil.copytree(finished[0], tmp_path, dirs_exist_ok=True)
    return tmp_path


def logged(log):
    """The digest of the trial in a log."""
    return content_digest(log)


def digests(trials):
    return {key: trial.digest for key, trial in trials.items()}


def test_a_brief_log_has_the_result_and_the_digest_of_the_trial_run_by_itself(tmp_path):
    ran = run(tmp_path)
    arm = ran.loaded.arms[3]
    sets = [*arm.sets, "trials.count=5", "trials.seed=7"]
    alone = parse_spec((tmp_path / "spec.yaml").read_text(), "spec.yaml", sets)
    run_trial(alone, tmp_path, 2)
    found = read_result(log_path(tmp_path, 2))
    brief = ran.finished[arm.name, 2]
    assert brief.brief and not found.brief
    assert brief.digest == logged(log_path(tmp_path, 2)) == logged(Path(brief.log))
    assert brief.result.total_error == found.result.total_error
    assert brief.warnings == found.warnings
    assert brief.processor == found.processor != ""


def test_a_brief_log_and_a_whole_one_give_the_same_result(finished, tmp_path):
    whole, brief = finished[1].finished, run(tmp_path, SMALL, logs=NONE).finished
    assert len(whole) == 6
    for key, one in whole.items():
        other, result = brief[key], one.result
        same = replace(other.result, solve_ns=result.solve_ns, verdict=result.verdict)
        assert replace(other, brief=False, result=same, log=one.log) == (
            replace(one, result=replace(result, deadline_misses=same.deadline_misses))
        )


def test_a_brief_log_is_small_and_a_damaged_one_is_run_again(tmp_path):
    ran = run(tmp_path, SMALL)
    log = Path(ran.finished[ARM, 1].log)
    content = log.read_bytes()
    assert len(content) < 10_000
    log.write_bytes(content[:-200])
    again = run(tmp_path, SMALL)
    assert [task.key for task in again.tasks] == [(ARM, 1)]
    assert digests(again.finished) == digests(ran.finished)


def test_trials_come_first_over_all_arms(finished):
    ran = finished[1]
    arms = [arm.name for arm in ran.loaded.arms]
    assert ran.watcher.started == [(arm, trial) for trial in range(3) for arm in arms]
    assert ran.watcher.endings[-1].left_s == 0
    assert ran.counts == (6, 0, 0)


def test_trials_of_outdated_code_are_named_and_run_again_only_on_demand(done, monkeypatch):
    table = (done / "out" / "trials.csv").read_bytes()
    monkeypatch.setattr(store, "code_of", lambda experiment: "newer")
    kept = run(done, SMALL, logs=ALL)
    assert (len(kept.tasks), kept.outdated) == (0, {"dead_time=0": 3, ARM: 3})
    again = run(done, SMALL, logs=ALL, rerun_outdated=True)
    assert (len(again.tasks), again.outdated) == (6, {})
    assert (done / "out" / "trials.csv").read_bytes() == table
    names = {path.name for path in (done / "out" / ARM).glob("*attempt*")}
    assert names == {f"trial-00{i}.attempt-1.mcap" for i in range(3)}


def test_a_study_of_another_spec_is_not_mixed_in(done):
    with pytest.raises(UsageError, match="another spec or seed"):
        run(done, SMALL.replace("seed: 7", "seed: 8"))


def test_more_trials_and_values_are_added_to_those_there_are(done):
    more = SMALL.replace("count: 3", "count: 4").replace("[0, 0.1]", "[0, 0.05, 0.1]")
    ran = run(done, more)
    assert len(ran.tasks) == 3 * 4 - 2 * 3
    assert len(ran.finished) == 12


def test_trials_whose_logs_are_damaged_or_gone_are_run_again(done):
    table = (done / "out" / "trials.csv").read_bytes()
    log_path(done / "out" / ARM, 1).unlink()
    torn = log_path(done / "out" / ARM, 2)
    torn.write_bytes(torn.read_bytes()[:-300])
    ran = run(done, SMALL, logs=ALL)
    assert [task.key for task in ran.tasks] == [(ARM, 1), (ARM, 2)]
    assert (done / "out" / "trials.csv").read_bytes() == table


def test_the_log_of_another_arm_is_refused(done):
    other = log_path(done / "out" / "dead_time=0", 1)
    log_path(done / "out" / ARM, 1).write_bytes(other.read_bytes())
    with pytest.raises(UsageError, match=r"trial-001.mcap: was run with another spec or seed"):
        run(done, SMALL, logs=ALL)


def test_an_arm_is_a_batch_and_a_batch_an_arm(done):
    table = (done / "out" / "trials.csv").read_bytes()
    loaded = run(done, SMALL).loaded
    for arm in loaded.arms:
        batch = Store.of_batch(done / "batches" / arm.name, arm.spec.experiment)
        with batch.opened(resume=False):
            tasks = batch_tasks(arm.spec, [0, 2])
            run_batch(tasks, batch, Here(Interrupt()), Watcher(), fail_fast=True)
    ran = run(done, SMALL, logs=ALL, out="batches")
    assert sorted(task.trial for task in ran.tasks) == [1, 1]
    assert ran.outdated == {}
    assert (done / "batches" / "trials.csv").read_bytes() == table
    resumed = Store.of_batch(done / "out" / ARM, loaded.arms[1].spec.experiment)
    resumed.read()
    assert resumed.lacking == []
    with pytest.raises(UsageError, match="holds logs already"):
        resumed.read(resume=False)


def test_a_trial_without_an_outcome_is_run_again_the_next_time(tmp_path, monkeypatch):
    real = spec_trial.run_observed

    def broken(writers, spec, trial, *more):
        if trial == 1:
            raise TetractlError("the disk is full")
        return real(writers, spec, trial, *more)

    monkeypatch.setattr(spec_trial, "run_observed", broken)
    ran = run(tmp_path, SMALL)
    assert ran.counts == (4, 2, 0)
    assert {why for *_, why in ran.watcher.failures} == {"the disk is full"}
    monkeypatch.undo()
    assert len(run(tmp_path, SMALL).tasks) == 2


@pytest.mark.parametrize(("logs", "kept"), [(ALL, 1), (NONE, 0)])
def test_an_interrupted_trial_is_run_again_and_its_log_set_aside(logs, kept, tmp_path):
    interrupt = Interrupt()

    class Stopper:
        def __getattr__(self, name):
            return lambda *args: name == "on_step" and interrupt.request()

    ran = run(tmp_path, SMALL, logs=logs, executor=Here(interrupt, [Stopper()]))
    assert ran.report.interrupted
    assert (ran.counts, ran.finished) == ((1, 0, 5), {})
    assert len([*tmp_path.rglob("trial-000.mcap")]) == kept
    again = run(tmp_path, SMALL, logs=logs)
    assert len(again.tasks) == 6
    assert len([*tmp_path.rglob("trial-000.attempt-1.mcap")]) == kept


def test_an_aborted_trial_is_finished_only_for_the_code_that_aborts_it(tmp_path, monkeypatch):
    assert len(run(tmp_path, FAILING).report.aborted) == 4
    assert run(tmp_path, FAILING).tasks == []
    monkeypatch.setattr(store, "code_of", lambda experiment: "mended")
    assert len(run(tmp_path, FAILING).tasks) == 4


def test_a_worker_with_other_code_ends_the_study(tmp_path, monkeypatch):
    monkeypatch.setattr(task, "code_of", lambda spec: "other")
    with pytest.raises(OtherCodeError, match="code differs"):
        run(tmp_path, SMALL)
    monkeypatch.undo()
    assert len(run(tmp_path, SMALL).tasks) == 6


def test_the_specs_of_tasks_are_those_of_the_arms(tmp_path):
    ran = run(tmp_path, SMALL)
    arms = {arm.name: arm for arm in ran.loaded.arms}
    for each in ran.tasks:
        assert pickle.loads(each.spec).experiment == arms[each.arm].spec.experiment

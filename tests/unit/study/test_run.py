import json
import pickle
import shutil
from dataclasses import replace

import pytest
from support.studies import SMALL, Watcher, run

from tetractl.core.errors import LogError, TetractlError, UsageError
from tetractl.experiment.load import parse_spec
from tetractl.log.read.reader import content_digest, read_result
from tetractl.run import task
from tetractl.run.batch import run_batch
from tetractl.run.executors import Here
from tetractl.run.interrupt import Interrupt
from tetractl.run.store import Store
from tetractl.run.task import OtherCodeError, batch_tasks, log_path, run_trial
from tetractl.study.options import Logs, repeat

ALL, NONE, FAILED = Logs(float("inf"), True), Logs(0, False), Logs(0, True)
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


def edit(folder, **fields):
    """Change fields of the rows of one arm on disk."""
    path = folder / ARM / "trials.jsonl"
    lines = [json.loads(line) | fields for line in path.read_text().splitlines()]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))


def without_logs(folder):
    """Make the rows of one arm those of trials that left no log."""
    for log in (folder / ARM).glob("*.mcap"):
        log.unlink()
    edit(folder, logged=False)


def digests(rows):
    return {key: row.digest for key, row in rows.items()}


def test_a_row_is_that_of_the_trial_run_by_itself(tmp_path):
    ran = run(tmp_path)
    assert not list(tmp_path.rglob("*.mcap*"))
    arm = ran.loaded.arms[3]
    sets = [*arm.sets, "trials.count=5", "trials.seed=7"]
    alone = parse_spec((tmp_path / "spec.yaml").read_text(), "spec.yaml", sets)
    run_trial(alone, tmp_path, 2)
    found = read_result(log_path(tmp_path, 2))
    row = ran.rows[arm.name, 2]
    assert row.digest == logged(log_path(tmp_path, 2))
    assert row.result.total_error == found.result.total_error
    assert row.warnings == found.warnings
    assert row.processor == found.processor != ""


def test_a_log_kept_changes_no_row(finished, tmp_path):
    kept, without = finished[1].rows, run(tmp_path, SMALL, logs=NONE).rows
    assert len(kept) == 6
    for (arm, trial), row in kept.items():
        other, result = without[arm, trial], row.result
        same = replace(other.result, solve_ns=result.solve_ns, verdict=result.verdict)
        assert not other.logged
        host = {"path": row.path, "wall_s": row.wall_s, "cpu_s": row.cpu_s}
        assert replace(other, logged=True, result=same, **host) == (
            replace(row, result=replace(result, deadline_misses=same.deadline_misses))
        )
        assert logged(log_path(finished[0] / "out" / arm, trial)) == row.digest


def test_trials_come_first_over_all_arms(finished):
    ran = finished[1]
    arms = [arm.name for arm in ran.loaded.arms]
    assert ran.watcher.started == [(arm, trial) for trial in range(3) for arm in arms]
    assert ran.watcher.endings[-1].left_s == 0
    assert ran.counts == (6, 0, 0)


def test_trials_of_outdated_code_are_named_and_run_again_only_on_demand(done):
    table = (done / "out" / "trials.csv").read_bytes()
    edit(done / "out", code="older")
    kept = run(done, SMALL, logs=ALL)
    assert (len(kept.tasks), kept.outdated) == (0, {ARM: 3})
    assert (done / "out" / "trials.csv").read_bytes() != table
    again = run(done, SMALL, logs=ALL, rerun_outdated=True)
    assert (len(again.tasks), again.outdated) == (3, {})
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
    assert len(ran.rows) == 12


def test_the_trials_of_damaged_rows_are_run_again(done, finished):
    without_logs(done / "out")
    path = done / "out" / ARM / "trials.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(lines[0] + b'{"trial": 1}\n\xff\xfe\n' + lines[2][:-9])
    ran = run(done, SMALL)
    assert [task.key for task in ran.tasks] == [(ARM, 1), (ARM, 2)]
    assert digests(ran.rows) == digests(finished[1].rows)
    assert path.read_bytes().count(b"\n") == 5


def test_a_log_without_a_row_is_a_finished_trial(done):
    """As a process leaves it that is killed between the two, or a batch that `run` has run."""
    table = (done / "out" / "trials.csv").read_bytes()
    path = done / "out" / ARM / "trials.jsonl"
    path.write_bytes(path.read_bytes().splitlines(keepends=True)[0])
    torn = log_path(path.parent, 2)
    torn.write_bytes(torn.read_bytes()[:-300])
    ran = run(done, SMALL, logs=ALL)
    assert [task.key for task in ran.tasks] == [(ARM, 2)]
    assert (done / "out" / "trials.csv").read_bytes() == table
    log_path(path.parent, 0).unlink()  # has a row
    other = log_path(done / "out" / "dead_time=0", 1)
    path.unlink()
    log_path(path.parent, 1).write_bytes(other.read_bytes())
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
    without_logs(done / "out")
    resumed = Store.of_batch(done / "out" / ARM, loaded.arms[1].spec.experiment)
    resumed.read()
    assert resumed.lacking == []  # it has their rows
    with pytest.raises(UsageError, match="holds logs already"):
        resumed.read(resume=False)


def test_a_trial_without_an_outcome_has_no_row_and_is_run_again_the_next_time(
    tmp_path, monkeypatch
):
    real = task.run_with

    def broken(writers, spec, trial, *more):
        if trial == 1:
            raise TetractlError("the disk is full")
        return real(writers, spec, trial, *more)

    monkeypatch.setattr(task, "run_with", broken)
    ran = run(tmp_path, SMALL)
    assert ran.counts == (4, 2, 0)
    assert {why for *_, why in ran.watcher.failures} == {"the disk is full"}
    monkeypatch.undo()
    assert len(run(tmp_path, SMALL).tasks) == 2


def test_an_interrupted_trial_leaves_neither_row_nor_log(tmp_path):
    interrupt = Interrupt()

    class Stopper:
        def __getattr__(self, name):
            return lambda *args: name == "on_step" and interrupt.request()

    ran = run(tmp_path, SMALL, logs=ALL, executor=Here(interrupt, [Stopper()]))
    assert ran.report.interrupted
    assert (ran.counts, ran.rows) == ((1, 0, 5), {})
    assert not list(tmp_path.rglob("*.mcap*"))


def test_a_trial_is_repeated_to_its_log(done):
    without_logs(done / "out")
    ran = run(done, SMALL)
    with ran.store.opened():
        says = repeat(ran.loaded, ran.store, f"{ARM}/1")
        row = ran.rows[ARM, 1]
        assert row.logged
        assert logged(log_path(done / "out" / ARM, 1)) == row.digest
        assert row.digest in says
        with pytest.raises(UsageError, match="has a log already"):
            repeat(ran.loaded, ran.store, f"{ARM}/1")
        for wrong in (ARM, f"{ARM}/x", f"{ARM}/7", "dead_time=0.2/0"):
            with pytest.raises(UsageError, match=f"--trial {wrong}"):
                repeat(ran.loaded, ran.store, wrong)
    ran.store.read()
    assert ran.rows[ARM, 1].logged


def test_a_trial_is_repeated_with_the_number_of_trials_it_was_run_with(done):
    """The number is in the resolved spec of each log, and so in its digest."""
    without_logs(done / "out")
    more = run(done, SMALL.replace("count: 3", "count: 4"))
    with more.store.opened():
        for trial in (1, 3):
            assert "with the digest of its row" in repeat(more.loaded, more.store, f"{ARM}/{trial}")


@pytest.mark.parametrize(
    ("changed", "hint"),
    [
        ({"code": "older"}, "the row was computed by outdated code"),
        (
            {"processor": "other-123456"},
            "the row was computed on another type of processor: other-123456, ",
        ),
    ],
)
def test_a_repeated_trial_that_differs_is_set_aside(done, changed, hint):
    without_logs(done / "out")
    edit(done / "out", content_digest="0" * 64, **changed)
    ran = run(done, SMALL)
    with ran.store.opened(), pytest.raises(LogError, match="the digest of its log is") as raised:
        repeat(ran.loaded, ran.store, f"{ARM}/1")
    assert raised.value.hint.startswith(hint)
    logs = [path.name for path in (done / "out" / ARM).glob("*.mcap")]
    assert logs == ["trial-001.attempt-1.mcap"]


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

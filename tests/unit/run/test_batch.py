from dataclasses import replace
from unittest import mock

import pytest
from testkit import random_trials as made
from testkit import studies
from testkit.running import QUICK

from tetractl.control.search.rng import mix
from tetractl.core.errors import AbortError
from tetractl.core.plan import Outcome
from tetractl.log.read.reader import read_trial
from tetractl.run import executors
from tetractl.run.batch import OnFailure, TrialTimes, run_batch
from tetractl.run.executors import local_executor
from tetractl.run.interrupt import Interrupt
from tetractl.run.logged_trial import log_path, run_logged
from tetractl.run.spec_trial import trial_seeds
from tetractl.run.store import Store
from tetractl.run.task import FinishedTrial, Task, batch_tasks
from tetractl.spec.load import parse_spec

SPEC = parse_spec(QUICK.replace("count: 3", "count: 4"), "quick.yaml")


class Watcher:
    """Stands for who watches a batch, and writes down which trials started and how they ended."""

    def __init__(self):
        self.events = []

    def trial_started(self, task):
        self.events.append(("started", task.trial, task.trial_count))

    def trial_ended(self, ending):
        outcome = ending.result and ending.result.outcome
        self.events.append(
            ("ended", ending.task.trial, outcome, ending.failure, ending.remaining_s)
        )


def scripted(monkeypatch, outcomes, action=lambda trial: None, can_restart=True):
    """Trials that end as `outcomes` says, by index, without being run; they take 2 s."""
    result = made.trial(1, steps=2, frames=2).result
    result = replace(result, verdict=replace(result.verdict, can_restart=can_restart))
    ran = []

    def run(task, folder, interrupt, observers, supervision):
        ran.append(task.trial)
        action(task.trial)
        outcome = outcomes.get(task.trial, Outcome.ARRIVED)
        if isinstance(outcome, Exception):
            raise outcome
        return FinishedTrial(replace(result, outcome=outcome, reason="why"), 2.0)

    monkeypatch.setattr(executors, "run_task", run)
    return ran


def run(folder, trials=range(4), jobs=1, interrupt=None, watcher=None, on_failure=OnFailure.END):
    executor = local_executor(jobs, len(trials), interrupt or Interrupt())
    store = Store.of_batch(folder, SPEC.experiment)
    return run_batch(batch_tasks(SPEC, trials), store, executor, watcher or Watcher(), on_failure)


def ran_of(report):
    return [trial for _, trial in report.results]


def test_trials_run_in_order_and_those_who_watch_learn_the_time_left(monkeypatch, tmp_path):
    ran = scripted(monkeypatch, {})
    watcher = Watcher()
    report = run(tmp_path, [0, 2, 3], watcher=watcher)
    assert ran == ran_of(report) == [0, 2, 3]
    assert watcher.events == [
        event
        for trial, left_s in ((0, 4.0), (2, 2.0), (3, 0.0))
        for event in (("started", trial, 4), ("ended", trial, Outcome.ARRIVED, None, left_s))
    ]
    assert (report.remaining, report.interrupted, report.aborted) == (0, False, {})


def task_of(arm):
    return replace(next(iter(batch_tasks(SPEC, [0]))), arm=arm)


def test_the_time_left_is_the_mean_of_each_arm_or_of_all_trials():
    times = TrialTimes([task_of(arm) for arm in ("slow", "slow", "slow", "quick", "new", "new")])
    assert times.remaining_s(1) is None
    times.record_end("slow", 30.0)
    times.record_end("slow", 50.0)
    times.record_end("quick", 4.0)
    assert not times.has_each_arm
    mean_s = (30 + 50 + 4) / 3
    assert times.remaining_s(1) == pytest.approx(40 + 2 * mean_s)
    assert times.remaining_s(4) == pytest.approx((40 + 2 * mean_s) / 4)
    times.record_end("slow", None)  # without a result, it says nothing about time
    assert times.remaining_s(1) == pytest.approx(2 * mean_s)
    times.record_end("new", 6.0)
    assert times.has_each_arm
    assert times.remaining_s(1) == pytest.approx(6.0)


@pytest.mark.parametrize("on_failure", OnFailure)
@pytest.mark.parametrize("can_restart", [True, False])
def test_an_aborted_trial_ends_the_run_if_that_is_asked_for(
    monkeypatch, tmp_path, on_failure, can_restart
):
    ran = scripted(monkeypatch, {1: Outcome.ABORTED}, can_restart=can_restart)
    watcher = Watcher()
    report = run(tmp_path, watcher=watcher, on_failure=on_failure)
    goes_on = on_failure is OnFailure.GO_ON or (
        on_failure is OnFailure.GO_ON_IF_CLEAR and can_restart
    )
    assert ran == ([0, 1, 2, 3] if goes_on else [0, 1])
    assert ([*report.aborted], report.remaining) == ([("", 1)], 0 if goes_on else 2)
    assert not report.interrupted
    assert [event[3] for event in watcher.events if event[0] == "ended"][1] == "aborted: why"


def test_a_trial_without_an_outcome_ends_a_batch_that_goes_on_after_aborts(monkeypatch, tmp_path):
    ran = scripted(monkeypatch, {0: Outcome.ABORTED, 1: AbortError("the port is gone")})
    report = run(tmp_path, on_failure=OnFailure.GO_ON_IF_CLEAR)
    assert ran == [0, 1]
    assert ([*report.errors], report.remaining) == ([("", 1)], 2)


@pytest.mark.parametrize(
    ("outcomes", "interrupted"), [({1: Outcome.INTERRUPTED}, True), ({}, False)]
)
def test_an_interruption_ends_the_run(monkeypatch, tmp_path, outcomes, interrupted):
    """Regression: between two trials it came too late, and the batch ended as if done."""
    interrupt = Interrupt()
    scripted(monkeypatch, outcomes, lambda trial: trial == 1 and interrupt.request())
    report = run(tmp_path, interrupt=interrupt, on_failure=OnFailure.GO_ON)
    assert (ran_of(report), report.remaining, report.interrupted) == ([0, 1], 2, interrupted)


def test_a_trial_is_logged_under_its_number_with_its_seeds(tmp_path):
    result = run_logged(SPEC, tmp_path, 2)
    assert [path.name for path in tmp_path.iterdir()] == ["trial-002.mcap"]
    log = read_trial(log_path(tmp_path, 2))
    assert log.result == replace(result, verdict=log.result.verdict)
    assert (log.start.trial, log.start.seed, log.damage) == (2, 7, None)
    assert log.steps[0].plan.generator == mix(trial_seeds(7, 2)[0], 0)
    numbers = log.frames.tolist()
    assert len(numbers) > 10
    assert len(set(numbers)) == len(numbers)


def kill_itself(task, folder):
    """As the work of a worker: the host's memory runs out at one trial."""
    log_path(folder, task.trial).with_suffix(".mcap.part").write_bytes(b"torn")
    if task.trial == 1:
        executors.os._exit(9)
    return executors.run_task(task, folder, Interrupt())


@pytest.mark.slow
@pytest.mark.system
def test_a_trial_that_kills_its_process_is_run_again_alone_and_then_fails(tmp_path, monkeypatch):
    monkeypatch.setattr(executors, "_work", kill_itself)
    report = run(tmp_path, [0, 1, 2], jobs=2, on_failure=OnFailure.GO_ON)
    assert sorted(ran_of(report)) == [0, 2]
    (error,) = report.errors.values()
    assert isinstance(error, AbortError)
    assert error.message == "a trial's process was killed twice, perhaps because memory ran out"
    assert "--jobs" in error.hint
    assert (tmp_path / "trial-001.attempt-1.mcap.part").exists()  # of the first time
    assert (tmp_path / "trial-001.mcap.part").exists()


class OneByOne:
    """An executor whose trials take 1 s in one arm and 4 s in another."""

    workers = 2

    def run(self, tasks, ready):
        result = made.trial(1, steps=2, frames=2).result
        for started in tasks:
            yield started, FinishedTrial(result, {"quick": 1.0, "slow": 4.0}[started.arm])


def left_at_ends(order):
    """The time left [s] at the end of each trial, and whether it is drawn from every arm."""
    tasks = [Task(trial, 10, b"", arm) for trial, arm in order]
    watcher = studies.Watcher()
    run_batch(tasks, mock.Mock(), OneByOne(), watcher)
    return [(ending.remaining_s, ending.has_time_of_each_arm) for ending in watcher.endings]


def test_the_time_left_is_drawn_from_every_arm():
    """It was that of the first trials on: 47 s that became 3 min, as one arm took four times as
    long as another."""
    times_left = left_at_ends([(i, arm) for i in range(10) for arm in ("quick", "slow")])
    assert times_left[:2] == [(19 * 1.0 / 2, False), (9 * (1.0 + 4.0) / 2, True)]
    assert times_left[-1] == (0.0, True)


@pytest.mark.parametrize("jobs", [1, 3])
def test_a_batch_of_nothing_is_done(tmp_path, jobs):
    """Regression: `--jobs 2 --resume` of a complete batch crashed."""
    report = run(tmp_path, [], jobs)
    assert (report.results, report.errors, report.remaining, report.interrupted) == (
        {},
        {},
        0,
        False,
    )

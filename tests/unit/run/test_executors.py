"""Tests of which requests end a worker's trial, and which end its process."""

import gc
import os
import signal
import subprocess
import sys
import threading
import weakref
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context

import pytest

from tetractl.core.errors import AbortError
from tetractl.run import executors
from tetractl.run.executors import (
    KILLED_TEXT,
    SIGTERM_INTERVAL_S,
    InProcessExecutor,
    ProcessExecutor,
    _SharedInterrupt,
    call_in_workers,
    local_executor,
)
from tetractl.run.interrupt import STOP_SIGNALS, Interrupt
from tetractl.run.task import FinishedTrial, Task

SOURCE = """
import os, signal
from multiprocessing import get_context
from tetractl.run.executors import _SharedInterrupt
ending = get_context("forkserver").Event()
shared = _SharedInterrupt(ending)
signal.signal(signal.SIGTERM, lambda number, frame: shared.end_at_once())
os.kill(os.getpid(), signal.SIGTERM)
print("goes on")
"""


@pytest.mark.long
@pytest.mark.skipif(os.name != "posix", reason="needs signals")
def test_a_worker_whose_pool_broke_ends_without_the_log_of_its_trial():
    """Regression: with its fork server killed, a pool ended workers by SIGTERM; these wrote logs of
    trials that "the user ended", which then were in the way of their repetition."""
    done = subprocess.run([sys.executable, "-c", SOURCE], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (1, "")


class Plant:
    """What a trial has in memory."""


def test_an_error_of_a_trial_does_not_keep_its_plant_in_memory(monkeypatch):
    """Regression: a refused run kept all frames of the camera until the program ended."""
    plants = []

    def refused(*_):
        plant = Plant()
        plants.append(weakref.ref(plant))
        raise AbortError("green is 76 mm from its start")

    monkeypatch.setattr("tetractl.run.executors.run_task", refused)
    ((_, error),) = InProcessExecutor(Interrupt()).run([None], lambda task: None)
    gc.collect()
    assert error.message == "green is 76 mm from its start"
    assert plants[0]() is None


def test_sigterm_after_a_request_is_the_second_request():
    ending = get_context("spawn").Event()
    shared = _SharedInterrupt(ending)
    ending.set()
    shared.end_at_once()
    assert shared.requested and shared.count == 2


# ---- Processes, with a pool that runs each task at once ----

TASKS = [Task(i, 9, b"") for i in range(9)]


class Pool:
    """Stands for a pool of workers: a task has ended when it is submitted.

    A worker is killed with a task of `deadly`, as often as it says, and a task of `failing` fails.
    """

    def __init__(self, deadly=None, failing=()):
        self.deadly = dict(deadly or {})
        self.failing = failing
        self.sizes = []
        self.submitted = []

    def __call__(self, context, workers, *_):
        self.sizes.append(workers)
        return self

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def submit(self, work, task, folder):
        self.submitted.append(task.trial)
        future = Future()
        if self.deadly.get(task.trial, 0) > 0:
            self.deadly[task.trial] -= 1
            future.set_exception(BrokenProcessPool("killed"))
        elif task.trial in self.failing:
            future.set_exception(AbortError(f"trial {task.trial} failed"))
        else:
            future.set_result(FinishedTrial(None, 0.1))
        return future


class Context:
    """Stands for the context of multiprocessing."""

    Event = threading.Event


@pytest.fixture
def pool(monkeypatch):
    def install(**options):
        pool = Pool(**options)
        monkeypatch.setattr(executors, "WorkerPool", pool)
        monkeypatch.setattr(executors, "create_clean_context", lambda modules: Context())
        return pool

    return install


def run_in_processes(workers, interrupt=None, on_start=lambda task, executor: None):
    """What becomes of each task that was started, in the order in which they ended."""
    executor = ProcessExecutor(workers, interrupt or Interrupt())

    def start_task(task):
        on_start(task, executor)

    return [(task.trial, ended) for task, ended in executor.run(TASKS, start_task)]


def test_every_task_is_started_once_and_ends_with_its_result(pool):
    workers = pool()
    ended = run_in_processes(3)
    assert workers.sizes == [3]
    assert workers.submitted == list(range(9))
    assert sorted(trial for trial, _ in ended) == list(range(9))
    assert all(isinstance(result, FinishedTrial) for _, result in ended)


def test_an_error_of_a_task_is_its_end_and_the_others_go_on(pool):
    pool(failing={4})
    ended = dict(run_in_processes(2))
    assert sorted(ended) == list(range(9))
    assert [trial for trial, result in ended.items() if isinstance(result, Exception)] == [4]
    assert ended[4].message == "trial 4 failed"


def test_a_trial_whose_worker_was_killed_is_repeated_alone_and_the_others_go_on(pool):
    workers = pool(deadly={2: 1})
    ended = run_in_processes(3)
    assert sorted(trial for trial, _ in ended) == list(range(9))
    assert all(isinstance(result, FinishedTrial) for _, result in ended)
    assert workers.submitted.count(2) == 2
    assert 1 in workers.sizes  # the repetition
    assert workers.sizes[-1] == 3  # then all workers again


def test_a_trial_whose_worker_is_killed_twice_fails_and_no_other_does(pool):
    workers = pool(deadly={2: 2})
    ended = dict(run_in_processes(1))
    assert sorted(ended) == list(range(9))
    assert [trial for trial, result in ended.items() if isinstance(result, Exception)] == [2]
    assert ended[2].message == KILLED_TEXT
    assert workers.submitted.count(2) == 2


def test_no_task_is_started_after_the_end_or_a_request(pool):
    workers = pool()

    def end_at_3(task, executor):
        if task.trial == 3:
            executor.end()

    ended = run_in_processes(2, on_start=end_at_3)
    assert workers.submitted == [0, 1, 2, 3]  # the one that was being started still runs
    assert sorted(trial for trial, _ in ended) == [0, 1, 2, 3]
    interrupt = Interrupt()
    interrupt.request()
    assert run_in_processes(2, interrupt) == []


def test_a_request_ends_the_workers_and_what_they_have_started_is_still_yielded(pool):
    workers = pool()
    interrupt = Interrupt()
    executor = ProcessExecutor(2, interrupt)
    ended = []
    for task, _ in executor.run(TASKS, lambda task: None):
        ended.append(task.trial)
        interrupt.request()
    assert sorted(ended) == sorted(workers.submitted)
    assert len(ended) == 2
    assert executor._ending.is_set()


class Worker:
    def __init__(self):
        self.terminated = 0

    def terminate(self):
        self.terminated += 1


def test_only_a_second_request_terminates_the_workers_and_again_every_second(pool, monkeypatch):
    pool()
    worker = Worker()
    monkeypatch.setattr(executors.multiprocessing, "active_children", lambda: [worker])
    now_s = 100.0
    monkeypatch.setattr(executors.time, "monotonic", lambda: now_s)
    interrupt = Interrupt(breaks_at=99)
    executor = ProcessExecutor(2, interrupt)
    for requests, at_s, terminated in [
        (0, 100.0, 0),
        (1, 100.0, 0),
        (2, 100.0, 1),
        (2, 100.0 + 0.9 * SIGTERM_INTERVAL_S, 1),
        (2, 100.0 + SIGTERM_INTERVAL_S, 2),
        (3, 100.0 + 1.5 * SIGTERM_INTERVAL_S, 2),
    ]:
        interrupt.count = requests
        now_s = at_s
        executor._stop_at_once()
        assert worker.terminated == terminated


# ---- Which executor, and the others ----


@pytest.mark.parametrize(
    ("jobs", "tasks", "workers"), [(1, 5, 1), (4, 1, 1), (4, 0, 1), (2, 5, 2), (8, 3, 3)]
)
def test_there_are_no_more_processes_than_jobs_or_tasks(pool, jobs, tasks, workers):
    pool()
    executor = local_executor(jobs, tasks, Interrupt())
    assert executor.workers == workers
    assert isinstance(executor, ProcessExecutor) == (workers > 1)


def test_in_this_process_nothing_is_started_after_the_end_or_a_request(monkeypatch):
    monkeypatch.setattr(executors, "run_task", lambda task, *_: FinishedTrial(None, 0.1))
    here = InProcessExecutor(Interrupt())
    started = [task.trial for task, _ in here.run(TASKS, lambda task: None)]
    assert started == list(range(9))
    for stop in (lambda executor, interrupt: executor.end(), lambda _, i: i.request()):
        interrupt = Interrupt()
        here = InProcessExecutor(interrupt)
        started = []
        for task, _ in here.run(TASKS, lambda task: None):
            started.append(task.trial)
            if task.trial == 2:
                stop(here, interrupt)
        assert started == [0, 1, 2]


def test_calls_are_answered_in_this_process_for_one_job_or_one_item(monkeypatch):
    def refuse(*_):
        raise AssertionError("a pool was started")

    monkeypatch.setattr(executors, "WorkerPool", refuse)
    for items, jobs in (([3, 1, 2], 1), ([3], 4), ([], 4)):
        assert list(call_in_workers(lambda x: 2 * x, items, jobs, print)) == [
            2 * item for item in items
        ]


def test_calls_of_several_jobs_go_to_a_pool_of_at_most_as_many_workers_as_items(monkeypatch):
    class Inline(Pool):
        def submit(self, call, item):
            future = Future()
            future.set_result(call(item))
            return future

    pool = Inline()
    monkeypatch.setattr(executors, "WorkerPool", pool)
    for items, jobs in (([3, 1], 2), ([3, 1, 2], 2), ([3, 1], 8)):
        assert sorted(call_in_workers(lambda x: 2 * x, items, jobs, print)) == sorted(
            2 * x for x in items
        )
    assert pool.sizes == [2, 2, 2]


# ---- A worker ----


def test_a_worker_is_asked_to_stop_by_its_parents_event_or_by_sigterm(monkeypatch):
    shared = _SharedInterrupt(threading.Event())
    assert not shared.requested
    shared.ending.set()
    assert shared.requested and shared.count == 0
    shared = _SharedInterrupt(threading.Event())
    shared.request()
    assert shared.requested


def test_sigterm_without_a_request_ends_the_process_and_after_one_breaks_the_trial(monkeypatch):
    class ExitedError(Exception):
        pass

    def leave(code):
        raise ExitedError(code)

    monkeypatch.setattr(executors.os, "_exit", leave)
    shared = _SharedInterrupt(threading.Event())
    with pytest.raises(ExitedError):
        shared.end_at_once()
    shared.ending.set()
    with pytest.raises(KeyboardInterrupt), shared.breakable():
        shared.end_at_once()


def test_signals_are_blocked_in_a_worker_while_it_starts_and_as_before_afterwards():
    if not hasattr(signal, "pthread_sigmask"):
        pytest.skip("needs signal masks")
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    with executors._block_signals():
        inside = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    assert inside >= set(STOP_SIGNALS)
    assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == before

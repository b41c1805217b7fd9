"""Tests of distributing trials to a cluster, with a fake scheduler."""

import logging
from importlib.util import find_spec

import pytest
from testkit.studies import Watcher

from tetractl.core.errors import AbortError
from tetractl.run import cluster
from tetractl.run.cluster import Cluster, chunk_size
from tetractl.run.interrupt import Interrupt
from tetractl.run.task import FinishedTrial, Task

pytestmark = pytest.mark.skipif(
    find_spec("distributed") is None, reason="distributed is not installed"
)


def killed():
    from distributed import KilledWorker  # slow to import

    return KilledWorker("task", None, 3)


class Client:
    """Stands for Dask's client: it runs each task when it is submitted, and kills the workers with
    a trial of `deadly`."""

    status = "running"

    def __init__(self, threads, deadly=()):
        self.threads = threads
        self.deadly = deadly
        self.chunks = []

    def nthreads(self):
        return {"worker": self.threads}

    def submit(self, work, tasks, pure):
        self.chunks.append([task.trial for task in tasks])
        lost = any(task.trial in self.deadly for task in tasks)
        return Future(killed() if lost else None, tasks)

    def cancel(self, futures):
        pass


class Future:
    """Stands for Dask's future of tasks that have ended, with an error or results."""

    def __init__(self, error, tasks):
        self.error = error
        self.tasks = tasks

    def exception(self):
        return self.error

    def result(self):
        return [(FinishedTrial(None, 0.05), None) for _ in self.tasks]

    def release(self):
        pass

    def add_done_callback(self, put):
        put(self)


def executor_of(client, interrupt=None):
    executor = Cluster("tcp://nowhere:1", interrupt or Interrupt())
    executor._client = client
    return executor


def tasks_of(count):
    return [Task(i, count, b"") for i in range(count)]


def run(client, count, tmp_path):
    """What becomes of so many trials that a cluster with this client runs."""
    watcher = Watcher()

    def ready(task):
        watcher.trial_started(task)
        return tmp_path

    ended = executor_of(client).run(tasks_of(count), ready)
    return {task.trial: outcome for task, outcome in ended}


def test_a_task_is_two_seconds_of_trials(tmp_path):
    client = Client(threads=4)
    outcomes = run(client, 2000, tmp_path)
    assert sorted(outcomes) == list(range(2000))
    sizes = list(map(len, client.chunks))
    assert sizes[:8] == [1] * 8  # nothing is known of the first
    assert max(sizes) == int(cluster.TASK_DURATION_S / 0.05) == 40
    assert len(sizes) < 150
    assert sizes[-1] == 1  # the last ones are shared out


def test_a_trial_that_kills_its_workers_fails_alone(tmp_path):
    client = Client(threads=1, deadly={100})
    outcomes = run(client, 200, tmp_path)
    assert sorted(outcomes) == list(range(200))
    failed = [trial for trial, outcome in outcomes.items() if isinstance(outcome, Exception)]
    assert failed == [100]
    assert str(outcomes[100]) == "the trial was lost, because every worker that ran it has stopped"
    assert [100] in client.chunks


@pytest.mark.parametrize(
    ("mean_s", "waiting", "size"),
    [
        (None, 10**6, 1),
        (10.0, 10**6, 1),
        (2.1, 10**6, 1),
        (1.0, 10**6, 2),
        (0.5, 10**6, 4),
        (0.01, 10**6, 200),
        (0.009, 10**6, 200),
        (1e-9, 10**6, 200),
        (0.0, 10**6, 200),
        (0.1, 80, 10),
        (0.1, 16, 2),
        (0.1, 7, 1),
    ],
)
def test_a_task_has_no_more_trials_than_its_time_its_size_and_its_share(mean_s, waiting, size):
    assert chunk_size(mean_s, waiting, 8) == size


distributed = pytest.importorskip("distributed")


class Closed:
    """Stands for a client of Dask that can do nothing but be closed."""

    def close(self):
        pass


def test_no_module_of_distributed_logs_a_lost_connection(monkeypatch):
    loggers = [
        logging.getLogger(name)
        for name in logging.root.manager.loggerDict
        if name.split(".")[0] == "distributed"
    ]
    for logger in loggers:
        monkeypatch.setattr(logger, "level", logging.NOTSET)
    monkeypatch.setattr(logging.getLogger("distributed"), "level", logging.INFO)
    monkeypatch.setattr(logging.getLogger("distributed.client"), "level", logging.WARNING)
    monkeypatch.setattr(distributed, "Client", lambda *args, **options: Closed())
    with Cluster("tcp://127.0.0.1:8786", Interrupt()):
        assert {logger.name for logger in loggers} >= {"distributed.batched", "distributed.core"}
        assert [logger.name for logger in loggers if logger.isEnabledFor(logging.ERROR)] == []


# ---- Which tasks are submitted, and when none is any more ----


class Later(Client):
    """A client whose tasks end only when a test says so."""

    def __init__(self, threads):
        super().__init__(threads)
        self.futures = []
        self.cancelled = []

    def submit(self, work, tasks, pure):
        future = super().submit(work, tasks, pure)
        self.futures.append(future)
        return future

    def cancel(self, futures):
        self.cancelled += futures


@pytest.mark.parametrize(("threads", "submitted"), [(1, 8), (4, 8), (5, 10), (20, 40)])
def test_two_tasks_of_each_thread_are_submitted_and_at_least_eight(tmp_path, threads, submitted):
    client = Later(threads)
    running = executor_of(client).run(tasks_of(90), lambda task: tmp_path)
    next(running)  # the first has ended, and no other was submitted yet
    assert len(client.chunks) == submitted


def test_no_task_is_submitted_after_the_end_or_a_request_and_the_running_ones_are_cancelled(
    tmp_path,
):
    interrupt = Interrupt()
    for stop in (lambda executor: executor.end(), lambda executor: interrupt.request()):
        client = Later(1)
        executor = executor_of(client, interrupt)
        ended = []
        for task, _ in executor.run(tasks_of(90), lambda task: tmp_path):
            ended.append(task.trial)
            if len(ended) == 3:
                stop(executor)
        assert ended == [0, 1, 2]
        assert len(client.cancelled) == len(client.futures) - 3
    assert list(executor_of(Later(1), interrupt).run(tasks_of(3), lambda task: tmp_path)) == []


def test_the_workers_are_counted_again_after_a_second_and_are_never_none(monkeypatch):
    now_s = 50.0
    monkeypatch.setattr(cluster.time, "monotonic", lambda: now_s)
    client = Client(threads=4)
    executor = executor_of(client)
    assert executor.workers == 4
    client.threads = 7
    now_s += 0.9 * cluster.COUNT_INTERVAL_S
    assert executor.workers == 4
    now_s += 0.1 * cluster.COUNT_INTERVAL_S
    assert executor.workers == 7
    client.threads = 0
    now_s += cluster.COUNT_INTERVAL_S
    assert executor.workers == 1
    client.threads = 9
    client.status = "closed"
    now_s += cluster.COUNT_INTERVAL_S
    assert executor.workers == 1  # nobody answers


def test_a_scheduler_that_is_gone_ends_the_run_with_one_error(tmp_path):
    client = Client(threads=1)
    client.status = "closed"
    client.submit = lambda work, tasks, pure: SilentFuture(tasks)
    with pytest.raises(AbortError, match="the scheduler does not answer any more"):
        list(executor_of(client).run(tasks_of(3), lambda task: tmp_path))


class SilentFuture(Future):
    def __init__(self, tasks):
        super().__init__(None, tasks)

    def add_done_callback(self, put):
        pass


def test_logs_that_workers_return_are_stored_where_each_trial_is_kept(tmp_path):
    class Returning(Future):
        def result(self):
            return [
                (FinishedTrial(None, 0.05), b"log" if task.trial % 2 else None)
                for task in self.tasks
            ]

    client = Client(threads=1)
    client.submit = lambda work, tasks, pure: Returning(None, tasks)
    for folder in range(4):
        (tmp_path / str(folder)).mkdir()
    ended = list(executor_of(client).run(tasks_of(4), lambda task: tmp_path / str(task.trial)))
    assert len(ended) == 4
    stored = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.mcap"))
    assert stored == ["1/trial-001.mcap", "3/trial-003.mcap"]


def test_an_error_of_a_task_is_the_end_of_each_of_its_trials(tmp_path):
    client = Client(threads=1)
    client.submit = lambda work, tasks, pure: Future(ValueError("cannot be unpickled"), tasks)
    ended = list(executor_of(client).run(tasks_of(3), lambda task: tmp_path))
    assert [str(error) for _, error in ended] == ["cannot be unpickled"] * 3

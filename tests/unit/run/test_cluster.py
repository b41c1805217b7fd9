"""Tests of distributing trials to a cluster, with a fake scheduler."""

import logging
from importlib.util import find_spec

import pytest
from testkit.studies import Watcher

from tetractl.run import cluster
from tetractl.run.cluster import Cluster, chunk_size
from tetractl.run.interrupt import Interrupt
from tetractl.run.task import Finished, Task

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
        return [(Finished(None, 0.05), None) for _ in self.tasks]

    def release(self):
        pass

    def add_done_callback(self, put):
        put(self)


def run(client, count, tmp_path):
    """What becomes of so many trials that a cluster with this client runs."""
    executor = Cluster("tcp://nowhere:1", Interrupt())
    executor._client = client
    watcher = Watcher()

    def ready(task):
        watcher.trial_started(task)
        return tmp_path

    tasks = [Task(i, count, b"") for i in range(count)]
    return {task.trial: outcome for task, outcome in executor.run(tasks, ready)}


def test_a_task_is_two_seconds_of_trials(tmp_path):
    client = Client(threads=4)
    outcomes = run(client, 2000, tmp_path)
    assert sorted(outcomes) == list(range(2000))
    sizes = list(map(len, client.chunks))
    assert sizes[:8] == [1] * 8  # nothing is known of the first
    assert max(sizes) == int(cluster.TASK_S / 0.05) == 40
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
    [(None, 10**6, 1), (10.0, 10**6, 1), (0.5, 10**6, 4), (1e-9, 10**6, 200), (0.1, 80, 10)],
)
def test_the_size_of_a_task(mean_s, waiting, size):
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

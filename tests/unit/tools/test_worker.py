"""Tests of the background worker: order, a full queue, failures, and the end."""

import threading

import pytest

from tetractl.core.errors import LogError
from tetractl.tools.worker import Worker


def make(size=10, wait_s=0.0, patience_s=10.0, **options):
    """Return a worker; `options` are those of Worker besides its limits."""
    limits = {"size": size, "wait_s": wait_s, "patience_s": patience_s}
    return Worker("test", **limits, too_slow=LogError("too slow"), **options)


def test_a_full_queue_fails_at_once_and_what_waits_is_still_done():
    done = []
    gate = threading.Event()
    worker = make(size=2)
    worker.put(gate.wait, 10)
    with pytest.raises(LogError, match="too slow"):
        for i in range(4):
            worker.put(done.append, i)
    worker.put(done.append, 9)  # dropped: the failure was raised
    gate.set()
    last = threading.Event()
    worker.close(last.set)
    assert last.wait(10)
    assert done == list(range(len(done)))
    assert 1 <= len(done) <= 2


def test_a_batch_of_calls_is_done_once_somebody_waits_for_them():
    done = []
    worker = make(size=3, wait_s=10.0, batch_s=3600.0)
    worker.put(done.append, 0)
    assert done == []
    worker.drain()
    assert done == [0]
    for i in range(1, 9):  # more than there are places for
        worker.put(done.append, i)
    worker.close(lambda: done.append(9))
    assert done == list(range(10))


def test_a_failure_is_raised_once_and_ends_the_calls_but_not_the_last():
    done = []
    worker = make()
    worker.put(lambda: 1 / 0)
    worker.put(done.append, "after")
    with pytest.raises(ZeroDivisionError):
        worker.drain()
    worker.put(done.append, "later")
    worker.close(lambda: done.append("last"))
    assert done == ["last"]
    assert isinstance(worker.failure, ZeroDivisionError)


def test_idle_is_called_after_each_call_and_when_its_time_has_come():
    called = threading.Semaphore(0)
    times = iter([0.001, 0.001, None])

    def idle():
        called.release()
        return next(times, None)

    worker = make(idle=idle)
    worker.put(lambda: None)
    for _ in range(3):
        assert called.acquire(timeout=10)
    worker.close()


def test_a_thread_that_does_not_end_is_a_failure():
    gate = threading.Event()
    worker = make(patience_s=0.01)
    worker.put(gate.wait, 10)
    with pytest.raises(LogError, match="too slow"):
        worker.drain()
    worker.close()
    gate.set()

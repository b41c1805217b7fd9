import threading
from contextlib import closing

import pytest

from tetractl.core.errors import LogError
from tetractl.run.task import Relay


class Watcher:
    def __init__(self, fail=None):
        self.calls, self.threads, self.fail = [], set(), fail
        self.gate = threading.Event()
        self.gate.set()

    def __getattr__(self, name):
        if not name.startswith("on_"):
            raise AttributeError(name)

        def call(*args):
            self.gate.wait(10)
            self.threads.add(threading.get_ident())
            self.calls.append((name, *args))
            if name == self.fail:
                raise LogError("disk full")

        return call


def test_calls_arrive_in_order_in_another_thread():
    watcher = Watcher()
    with closing(Relay(watcher)) as observer:
        observer.on_start("start")
        for i in range(100):
            observer.on_samples(i)
            observer.on_step(i)
        observer.on_note("note")
        observer.on_command("command")
        observer.on_stop("stop", "result")
    assert watcher.calls[0] == ("on_start", "start")
    assert watcher.calls[1:201:2] == [("on_samples", i) for i in range(100)]
    assert watcher.calls[-1] == ("on_stop", "stop", "result")
    assert len(watcher.threads) == 2


def test_a_failure_comes_out_at_the_end_at_the_latest_and_nothing_follows_it():
    watcher = Watcher(fail="on_step")
    with closing(Relay(watcher)) as observer:
        observer.on_step(1)
        with pytest.raises(LogError, match="disk full"):
            observer.on_stop("stop", "result")
    assert watcher.calls == [("on_step", 1)]

"""Tests of passing a trial's events to an observer in another thread."""

import threading
from contextlib import closing

from tetractl.run.observer_relay import ObserverRelay


class Watcher:
    """Stands for an observer that writes down its calls, and the threads from which they came."""

    def __init__(self):
        self.calls = []
        self.threads = set()

    def __getattr__(self, name):
        if not name.startswith("on_"):
            raise AttributeError(name)

        def call(*args):
            self.threads.add(threading.get_ident())
            self.calls.append((name, *args))

        return call


def test_calls_arrive_in_order_in_another_thread():
    watcher = Watcher()
    with closing(ObserverRelay(watcher)) as observer:
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

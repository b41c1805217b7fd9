"""Tests of a run whose terminal accepts no more output, in virtual time."""

import io
import itertools
import threading
from unittest import mock

import pytest
from rich.console import Console
from testkit.emulator.virtual_lab import virtual_lab

from tetractl.core.plan import Outcome
from tetractl.core.protocols import Observer
from tetractl.run import observer_relay
from tetractl.run.interrupt import Interrupt
from tetractl.run.logged_trial import run_logged
from tetractl.view.terminal.live_screen import LiveView

pytestmark = pytest.mark.long


class StuckTerminal(io.StringIO):
    """A terminal that lets every write wait, from when it is `stuck` until it is `released`."""

    def __init__(self):
        super().__init__()
        self.stuck = threading.Event()
        self.released = threading.Event()

    def write(self, text):
        if self.stuck.is_set():
            self.released.wait()
        return super().write(text)


class StopsReading(Observer):
    """Lets a terminal be stuck from the third control step on."""

    def __init__(self, terminal):
        self.terminal = terminal

    def on_step(self, step):
        if step.k == 2:
            self.terminal.stuck.set()


def test_a_terminal_that_takes_nothing_stops_the_robots_of_its_run(tmp_path):
    terminal = StuckTerminal()
    console = Console(file=terminal, force_terminal=True, width=100, height=30)
    few = mock.patch.multiple(observer_relay, QUEUED_CALLS_MAX=100, LAST_CALLS_S=0.01)
    each_call_s = itertools.count().__next__  # so that every picture is due
    view = LiveView(console, each_call_s)
    with virtual_lab(tmp_path, "controller.time_limit=300") as lab, few, view:
        try:
            result = run_logged(lab.spec, tmp_path, 0, [StopsReading(terminal), view], Interrupt())
        finally:
            terminal.released.set()
        moving = {event["name"]: event["moving"] for event in lab.events("robot")}
    assert result.outcome is Outcome.ABORTED
    assert "an observer takes too long for the trial" in result.reason
    assert moving
    assert not any(moving.values())

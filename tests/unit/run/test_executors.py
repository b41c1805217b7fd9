"""Tests of which requests end a worker's trial, and which end its process."""

import gc
import os
import subprocess
import sys
import weakref
from multiprocessing import get_context

import pytest

from tetractl.core.errors import AbortError
from tetractl.run.executors import Here, _SharedInterrupt
from tetractl.run.interrupt import Interrupt

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
    ((_, error),) = Here(Interrupt()).run([None], lambda task: None)
    gc.collect()
    assert error.message == "green is 76 mm from its start"
    assert plants[0]() is None


def test_sigterm_after_a_request_is_the_second_request():
    ending = get_context("spawn").Event()
    shared = _SharedInterrupt(ending)
    ending.set()
    shared.end_at_once()
    assert shared.requested and shared.count == 2

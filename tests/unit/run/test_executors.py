"""Which requests end the trial of a worker, and which its process."""

import os
import subprocess
import sys

import pytest

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

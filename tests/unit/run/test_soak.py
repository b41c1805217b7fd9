"""Many trials, and a long one: nothing piles up, and no camera sample is missing from a log.

A thousand trials and two hours in benchmarks/log.py.
"""

import threading
from pathlib import Path

import pytest
from support.durable import ENDLESS

from tetractl.experiment.load import parse_spec
from tetractl.log.read.reader import read_trial
from tetractl.run.task import log_path, run_trial

HANDLES = Path("/proc/self/fd")
SHORT = ["controller.steps_max=5", "plant.camera_rate=30"]


@pytest.mark.slow
def test_no_trial_leaves_a_thread_or_a_handle_behind(tmp_path):
    if not HANDLES.exists():
        pytest.skip("no /proc here")
    spec = parse_spec(ENDLESS, "short.yaml", SHORT)
    run_trial(spec, tmp_path)
    before = len(list(HANDLES.iterdir())), threading.active_count()
    for i in range(1, 40):
        run_trial(spec, tmp_path, i)
        log = read_trial(log_path(tmp_path, i))
        assert log.damage is None
        assert log.frames.tolist() == list(range(len(log.frames)))
    # threads and sockets of an earlier test may have ended meanwhile
    assert len(list(HANDLES.iterdir())) <= before[0]
    assert threading.active_count() <= before[1]

"""Tests that robots whose program MicroPython runs drive like those with the program in C."""

import pytest
from testkit.cli import tetractl
from testkit.emulator.micropython_robots import MISSING, micropython_robots

from tetractl.log.read.reader import read_trial

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(MISSING, reason="left out: node, and npm's MicroPython in NODE_PATH"),
]


def test_a_trial_of_robots_in_micropython_has_the_same_bits_as_in_c(tmp_path):
    tetractl(tmp_path, "init", "shelf", "--lab", "--robots", "twist").ok()
    run = "run shelf.yaml --plant emulated --trials 1 --quiet --set controller.time_limit=3 --out"
    with micropython_robots() as ran:
        tetractl(tmp_path, *run.split(), "micropython").ok()
    assert ran == {"micropython"}
    tetractl(tmp_path, *run.split(), "c").ok()
    python = read_trial(tmp_path / "micropython" / "trial-000.mcap")
    c = read_trial(tmp_path / "c" / "trial-000.mcap")
    assert (python.mocap == c.mocap).all()
    assert len(python.steps) == len(c.steps) > 5
    tetractl(tmp_path, "verify", "micropython").ok()

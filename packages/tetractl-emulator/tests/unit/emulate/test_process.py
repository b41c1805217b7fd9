"""Tests of faults that act on another process of this computer."""

import os
import subprocess
import sys
from types import SimpleNamespace

from tetractl_emulator.process import Process

from tetractl.core.clock import MonotonicClock

DRIVER = """
import fcntl, sys
port = open("port")
fcntl.flock(port, fcntl.LOCK_EX)
print("locked", flush=True)
input()
import late
try:
    open("log", "w", buffering=1).write("a step\\n")
except OSError:
    print("full", late.NUMBER)
"""
"""A process that has the port, and imports a module after its disk is full."""


def test_a_full_disk_leaves_no_bytecode_of_a_module_that_is_cut_short(tmp_path):
    (tmp_path / "port").touch()
    (tmp_path / "late.py").write_text("NUMBER = 7\n")
    writing = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    command = [sys.executable, "-c", DRIVER]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, cwd=tmp_path, env=writing, **pipes) as driver:
        assert driver.stdout.readline() == "locked\n"
        lab = SimpleNamespace(port=tmp_path / "port")
        Process(lab, MonotonicClock()).fill_disk()
        said, _ = driver.communicate("\n")
    assert said == "full 7\n"
    assert list(tmp_path.glob("__pycache__/*.pyc")) == []

"""Tests of the command `tetractl lab emulate`: its start, its end by signals, and its clean-up."""

import signal
import subprocess

import pytest
from testkit.emulator.lab_processes import PATIENCE_S, SPEC, TETRACTL

pytestmark = pytest.mark.system

UNICAST = ("--set", "lab.camera.transport=unicast", "--command-port", "0", "--data-port", "0")


def emulate(folder, *options):
    command = [TETRACTL, "lab", "emulate", str(SPEC), *UNICAST, *options]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_it_says_ready_and_ends_cleanly(tmp_path, number):
    with emulate(tmp_path, "--port-link", "radio") as process:
        line = process.stdout.readline()
        assert line.startswith("ready: cameras at 127.0.0.1:")
        assert "EMULATION, no hardware" in line
        assert (tmp_path / "radio").is_symlink()
        process.send_signal(number)
        out, errors = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, out) == (0, "")
    assert errors == "the emulation has stopped\n"
    assert list(tmp_path.iterdir()) == []

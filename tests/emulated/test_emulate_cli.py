"""`tetractl lab emulate` as a command: ready, ended by signals, nothing left behind."""

import signal
import subprocess

import pytest
from support.lab_processes import PATIENCE_S, SPEC, TETRACTL

UNICAST = ("--set", "lab.camera.transport=unicast", "--command-port", "0", "--data-port", "0")


def emulate(folder, *options, spec=SPEC):
    command = [TETRACTL, "lab", "emulate", str(spec), *UNICAST, *options]
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
    assert errors == "the emulation has ended\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (("--port-link", "/no/such/folder/radio"), 2, "cannot make the port"),
        (("--port-link", "."), 2, "is there already"),
        (("--script", "none.yaml"), 2, "no such file"),
        (("--port-link", "radio", "--record", "/no/such/folder/r"), 1, "cannot write the record"),
        (("--port-link", "radio", "--address", "192.0.2.1"), 1, "cannot take UDP 192.0.2.1"),
    ],
)
def test_what_cannot_be_is_one_clear_line(tmp_path, options, code, message):
    with emulate(tmp_path, *options) as process:
        out, errors = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, out) == (code, "")
    assert message in errors
    assert "Traceback" not in errors
    assert not (tmp_path / "radio").is_symlink()


def test_a_spec_without_a_lab_is_refused(tmp_path):
    with emulate(tmp_path, spec=SPEC.with_name("single_cell.yaml")) as process:
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 2
    assert "lab" in errors

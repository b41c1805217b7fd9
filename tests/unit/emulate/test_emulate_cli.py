"""`tetractl lab emulate` where it cannot begin."""

import pytest
from support.cli import tetractl
from support.lab_processes import SPEC

UNICAST = ("--set", "lab.camera.transport=unicast", "--command-port", "0", "--data-port", "0")


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (("--port-link", "/no/such/folder/radio"), 2, "cannot make the port"),
        (("--port-link", "."), 2, "exists already"),
        (("--script", "none.yaml"), 2, "no such file"),
        (("--port-link", "radio", "--record", "/no/such/folder/r"), 1, "cannot write the record"),
        (("--port-link", "radio", "--address", "192.0.2.1"), 1, "cannot take UDP 192.0.2.1"),
    ],
)
def test_what_cannot_be_is_one_clear_line(tmp_path, options, code, message):
    done = tetractl(tmp_path, "lab", "emulate", SPEC, *UNICAST, *options)
    assert (done.returncode, done.stdout) == (code, "")
    assert message in done.stderr
    assert not (tmp_path / "radio").is_symlink()


def test_a_spec_without_a_lab_is_refused(tmp_path):
    done = tetractl(tmp_path, "lab", "emulate", SPEC.with_name("single_cell.yaml"))
    assert done.returncode == 2
    assert "lab" in done.stderr

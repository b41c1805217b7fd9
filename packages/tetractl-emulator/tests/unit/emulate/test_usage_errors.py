"""Tests of mistakes in calls of `tetractl lab emulate`: one line, an exit code, no side effects."""

import shlex

import pytest
from testkit.cli import tetractl
from testkit.paths import ROOT
from testkit.running import QUICK

pytestmark = pytest.mark.slow

PORTS = "--set lab.camera.transport=unicast --command-port 0 --data-port 0"
ROWS = """
2 | spec.yaml | has no lab
2 | lab.yaml --port-link /no/such/folder/radio | cannot create the link
2 | lab.yaml --port-link . | exists already
2 | lab.yaml --script none.yaml | no such file
1 | lab.yaml --port-link radio --record /no/such/folder/r | cannot write the record
1 | lab.yaml --port-link radio --address 192.0.2.1 | cannot open UDP 192.0.2.1
"""


@pytest.mark.parametrize("row", ROWS.strip().splitlines())
def test_it_is_one_line_and_leaves_nothing(tmp_path, row):
    code, words, message = map(str.strip, row.split("|"))
    (tmp_path / "spec.yaml").write_text(QUICK)
    text = (ROOT / "experiments" / "three_m3pi_lab.yaml").read_text()
    (tmp_path / "lab.yaml").write_text(text.replace("/dev/ttyUSB0", str(tmp_path / "radio")))
    sockets = PORTS if words.startswith("lab") else ""
    done = tetractl(tmp_path, "lab", "emulate", *shlex.split(f"{words} {sockets}"))
    error, *hints = done.stderr.splitlines()
    assert (done.returncode, done.stdout) == (int(code), "")
    assert error.startswith("error: ") and message in error
    assert [hint for hint in hints if not hint.startswith("hint: ")] == []
    assert {path.name for path in tmp_path.iterdir()} == {"spec.yaml", "lab.yaml"}

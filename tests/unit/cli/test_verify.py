"""Tests of the lines and the exit code of `verify`."""

import json
from dataclasses import dataclass
from pathlib import Path

import pytest

from tetractl.cli import verify as module
from tetractl.cli.verify import verify
from tetractl.core.errors import Exit, LogError


@dataclass
class Verified:
    """What was found of a log."""

    verdict: str
    checked: int = 3

    @property
    def ok(self):
        return self.verdict == "ok"

    @property
    def lines(self):
        return [f"{self.verdict}: {self.checked} steps"]


OK, FAILED, CUT = Verified("ok"), Verified("FAILED"), Verified("not checked to the end")
BROKEN = LogError("b.mcap: no log")


@pytest.fixture
def run(monkeypatch, capsys):
    """Verify logs with these findings; returns the exit code and what is printed."""

    def of(*findings, as_json=False):
        left = list(findings)

        def check(path, announce):
            found = left.pop(0)
            if isinstance(found, Exception):
                raise found
            return found

        monkeypatch.setattr(
            module, "find_logs", lambda logs: [Path(f"{'abc'[i]}.mcap") for i in range(len(left))]
        )
        monkeypatch.setattr("tetractl.verification.verify.verify", check)
        code = verify(["x"], as_json=as_json)
        return code, capsys.readouterr().out

    return of


@pytest.mark.parametrize(
    ("findings", "code"),
    [
        ([OK], 0),
        ([OK, OK], 0),
        ([OK, FAILED], 1),
        ([FAILED, OK], 1),
        ([OK, CUT], 3),
        ([CUT, FAILED], 1),
        ([OK, BROKEN], 1),
        ([BROKEN, CUT], 1),
    ],
)
@pytest.mark.parametrize("as_json", [False, True])
def test_the_worst_log_decides(run, findings, code, as_json):
    assert run(*findings, as_json=as_json)[0] == Exit(code)


def test_each_log_has_its_lines(run):
    _, text = run(OK, BROKEN, FAILED)
    assert text.splitlines() == ["ok: 3 steps", "b.mcap: FAILED: no log", "FAILED: 3 steps"]


def test_json_is_one_object(run):
    _, text = run(OK, BROKEN, as_json=True)
    found = json.loads(text)
    assert found["ok"] is False
    first, second = found["logs"]
    assert (first["ok"], first["verdict"], first["checked"]) == (True, "ok", 3)
    assert (second["ok"], second["verdict"]) == (False, "FAILED")
    assert second["error"] == "b.mcap: no log"
    assert json.loads(run(OK, as_json=True)[1])["ok"] is True

"""Every benchmark starts: none is left behind by a change of what it measures."""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.system

SCRIPTS = sorted((Path(__file__).parents[2] / "benchmarks").glob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_it_tells_what_it_measures(script, tmp_path, monkeypatch, capsys):
    """In this process, which imports once what they share."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [script.name, "--help"])
    monkeypatch.setattr(sys, "path", [str(script.parent), *sys.path])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(script), run_name="__main__")
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith("usage:")
    assert list(tmp_path.iterdir()) == []


def test_the_long_run_prints_what_it_found(tmp_path):
    (script,) = (path for path in SCRIPTS if path.stem == "fuzz")
    words = [sys.executable, script, "--target", "serial", "--seconds", "0.2"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    *_, row = done.stdout.splitlines()
    name, runs, crashes = row.strip("| ").split(" | ")[:3]
    assert (name, crashes) == ("serial", "0")
    assert int(runs) > 0
    assert list(tmp_path.iterdir()) == []

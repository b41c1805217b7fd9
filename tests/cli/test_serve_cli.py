"""Tests of `open`, and of `run --serve` in a separate process with a real viewer."""

import os
import re
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from testkit import random_trials as made
from testkit.running import QUICK, TETRACTL, Started
from testkit.viewer import PATIENCE_S, Viewer, deaf

from tetractl.log.format.channels import CHANNELS, SCENE, TRANSFORMS
from tetractl.log.read.reader import read_result

WITHOUT = "import sys; sys.modules['websockets'] = None; from tetractl.cli import main; main()"
ADDRESS = re.compile(r"((?:ws|http)://127\.0\.0\.1:\d+/[\w-]{16,}/?)\n")

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    return made.write(made.trial(1, steps=20, frames=10), folder / "trial-000.mcap")


@contextmanager
def command(*words, cwd):
    """A command, and the `url` at which it says that it serves."""
    with Started(cwd, *words) as served:
        served.until(lambda: ADDRESS.search(served.printed()))
        served.url = ADDRESS.findall(served.printed())[0]
        yield served
        assert "Traceback" not in served.printed()


@pytest.mark.system
def test_a_run_is_served_while_it_runs_and_its_log_stays_the_same(tmp_path):
    (tmp_path / "spec.yaml").write_text(QUICK.replace("count: 3", "count: 2"))
    run = ("run", "spec.yaml", "--quiet", "--out")
    args = (*run, "served", "--serve", "--port", "0")
    with command(*args, cwd=tmp_path) as served:
        with deaf(served.url, len(CHANNELS)), Viewer(served.url) as viewer:
            viewer.subscribe()
            start_ns, _ = viewer.message(SCENE)
            viewer.until(lambda got: got[0] == TRANSFORMS and got[1] > start_ns)
            assert viewer.message(SCENE)[0] == start_ns  # of the second trial
            viewer.until(lambda got: got[0] == TRANSFORMS and got[1] > start_ns)
        assert served.process.wait(PATIENCE_S) == 0
    subprocess.run([TETRACTL, *run, "alone"], cwd=tmp_path, capture_output=True, check=True)
    for name in ("trial-000.mcap", "trial-001.mcap"):
        digest = read_result(tmp_path / "served" / name).digest
        assert digest == read_result(tmp_path / "alone" / name).digest


def test_without_the_extra_one_clear_line_says_how_to_get_it(tmp_path):
    (tmp_path / "spec.yaml").write_text(QUICK)
    words = ["run", "spec.yaml", "--serve"]
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT, *words],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env=os.environ,
    )
    assert done.returncode == 2
    assert done.stderr == (
        "error: this command needs websockets, which is not installed\n"
        "hint: install it in your copy of the tetractl repository with: pip install '.[serve]'\n"
    )
    assert done.stdout == ""
    assert not (tmp_path / "logs").exists()


def test_the_page_of_a_trial_is_written_and_opened(log, tmp_path, monkeypatch):
    """BROWSER names a program that is given the page's address."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setenv("BROWSER", "/bin/sh -c 'echo \"$0\" > opened' %s")
    done = subprocess.run(
        [TETRACTL, "open", log], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    page = Path(done.stdout.rstrip("\n"))
    assert not (tmp_path / "report.html").exists()  # it may be one that somebody keeps
    assert 'id="trial-data-0"' in page.read_text()
    assert (tmp_path / "opened").read_text() == f"{page.as_uri()}\n"

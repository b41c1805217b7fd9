"""`serve`, `open` and `run --serve`: commands in processes of their own, read by a real viewer."""

import os
import re
import signal
import subprocess
import sys
from contextlib import contextmanager
from urllib.parse import parse_qs, urlsplit
from urllib.request import Request, urlopen

import pytest
from support import random_trials as made
from support.running import QUICK, TETRACTL, Started, first_of
from support.terminal import Terminal
from support.viewer import PATIENCE_S, Viewer, deaf

from tetractl.log.format.channels import CHANNELS, FRAMES, SCENE, TRANSFORMS
from tetractl.log.read.reader import read_result
from tetractl.log.read.salvage import scan

WITHOUT = "import sys; sys.modules['websockets'] = None; from tetractl.cli import main; main()"
ADDRESS = re.compile(r"((?:ws|http)://127\.0\.0\.1:\d+/[\w-]{16,}/?)\n")
MS = 1_000_000

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    return made.write(made.trial(1, steps=20, frames=10), folder / "trial-000.mcap")


@contextmanager
def command(*words, cwd):
    """A command, and the `url` at which it says that it serves."""
    with Started(cwd, *words) as served:
        found = []
        served.until(lambda: found.extend(ADDRESS.findall(served.said())) or found)
        served.url = found[0]
        yield served
        assert "Traceback" not in served.said()


def unix_ns(viewer, name):
    time = viewer.info[name]
    return time["sec"] * 10**9 + time["nsec"]


def test_a_viewer_plays_pauses_seeks_and_sets_the_rate(log):
    args = ("serve", log.name, "--port", "0", "--paused", "--no-loop", "--no-browser")
    with command(*args, cwd=log.parent) as served, Viewer(served.url) as viewer:
        first_ns, last_ns = unix_ns(viewer, "dataStartTime"), unix_ns(viewer, "dataEndTime")
        logged = scan(log).entries
        assert viewer.info["capabilities"] == ["time", "playbackControl"]
        viewer.subscribe()
        assert viewer.message(SCENE)[1].entities[0].id == "arena"
        assert viewer.state().status == "paused"

        viewer.control(True, 64.0, request="play")
        assert viewer.state(request="play").status == "playing"
        assert viewer.state(status="ended").time_ns == last_ns
        due = [one for one in logged if one.topic == FRAMES and one.log_ns > first_ns]
        viewer.seen(lambda got: got[2] == due[-1].data)
        sent = {got[2] for got in viewer.all if got[0] == FRAMES}
        assert {entry.data for entry in due} <= sent

        viewer.all.clear()
        there_ns = (first_ns + last_ns) // 2
        viewer.control(False, 0.5, seek_ns=there_ns, request="seek")
        told = viewer.state(request="seek")
        assert (told.status, told.time_ns, told.rate, told.sought) == (
            "paused",
            there_ns,
            0.5,
            True,
        )
        served.process.send_signal(signal.SIGINT)
        assert served.process.wait(PATIENCE_S) == 0
        (shown,) = re.findall(r"in Foxglove: (\S+)", served.said())
        link = urlsplit(shown)
        assert link.hostname == "app.foxglove.dev"
        assert parse_qs(link.query)["ds.url"] == [served.url]


@pytest.mark.system
def test_the_keys_of_the_terminal_and_the_viewer_command_the_same_player(log):
    words = [str(TETRACTL), "serve", log.name, "--port", "0", "--paused", "--no-browser"]
    with Terminal(words, log.parent, columns=80, rows=24) as terminal:
        url = terminal.expect(r"ws://127\.0\.0\.1:\d+/[\w-]{16}")
        terminal.expect(f"(?s)served at.*{re.escape(url)}")  # on the screen too, whole
        with Viewer(url) as viewer:
            viewer.subscribe(SCENE)
            assert viewer.state().status == "paused"
            terminal.press("+")
            viewer.state(rate=2.0)
            terminal.press("l")
            terminal.press("\x1b[C")
            viewer.state(sought=True, time_ns=unix_ns(viewer, "dataStartTime") + 1000 * MS)
            viewer.control(False, 4.0, request="rate")
            terminal.expect("4×")
            terminal.press("q")
            assert terminal.finish() == 0


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
        served, alone = (read_result(tmp_path / one / name) for one in ("served", "alone"))
        assert served.digest == alone.digest


@pytest.mark.parametrize(
    "words", first_of([["serve", "LOG"], ["run", "spec.yaml", "--serve"], ["serve", "spec.yaml"]])
)
def test_without_the_extra_one_clear_line_says_how_to_get_it(log, tmp_path, words):
    (tmp_path / "spec.yaml").write_text(QUICK)
    words = [str(log) if word == "LOG" else word for word in words]
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
        "error: this needs websockets, which is not installed\n"
        "hint: pip install 'tetractl[serve]'\n"
    )
    assert done.stdout == ""
    assert not (tmp_path / "logs").exists()


def test_a_trial_is_opened_until_ctrl_c(log):
    words = ("open", log.name, "--no-browser", "--lichtblick", "http://127.0.0.1:1")
    with command(*words, cwd=log.parent) as served:
        with urlopen(served.url) as page:
            assert b'id="trial-data-0"' in page.read()
        asked = Request(f"{served.url}logs/0-trial-000.mcap", headers={"Range": "bytes=0-7"})
        with urlopen(asked) as part:
            assert (part.status, part.read()) == (206, log.read_bytes()[:8])
        served.process.send_signal(signal.SIGINT)
        assert served.process.wait(PATIENCE_S) == 0
        assert served.said().count("http://") == 1 and "ssh -L" in served.said()

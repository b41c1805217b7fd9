"""Signals, and terminals and pipes that vanish or stand still, to real processes."""

import fcntl
import os
import pty
import re
import select
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from support.running import (
    ENDLESS,
    HEAVY,
    PATIENCE_S,
    QUICK,
    TETRACTL,
    Running,
    assert_interrupted,
    environment,
    first_of,
    is_worker,
)
from support.studies import SMALL, tetractl, write

from tetractl.log.read.reader import read_result

pytestmark = pytest.mark.long

NAMES = ["SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGUSR1", "SIGALRM", "SIGABRT", "SIGRTMIN"]
LINUX = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs Linux's /proc")


@pytest.mark.parametrize("name", first_of(NAMES))
def test_every_signal_finishes_the_step_and_the_log(tmp_path, name):
    with Running(tmp_path, ENDLESS) as running:
        running.until_logging(1, size=30_000)
        running.process.send_signal(getattr(signal, name))
        assert running.end() == 130
        assert_interrupted(running, 1, "interrupted; the step was finished")


@pytest.mark.system
@pytest.mark.parametrize("spec", [ENDLESS, HEAVY], ids=["endless", "heavy"])
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_eight_signals_at_once_lose_neither_the_log_nor_the_last_lines(tmp_path, spec, jobs):
    with Running(tmp_path, spec, "--jobs", jobs) as running:
        running.until_logging(int(jobs))
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT) * 2:
            running.process.send_signal(number)
            time.sleep(0.002)  # apart, so that two of a kind do not arrive as one
        assert running.end() == 130
        for path in running.logs.glob("*.mcap"):
            assert not read_result(path).recovered
        lines = running.err.read_text().splitlines()
        assert lines[-2].startswith("logs in logs")
        assert lines[-1] == "interrupted; continue with the same command and --out logs --resume"


@pytest.mark.parametrize("module", first_of(["numba", "typer", "pydantic", "tetractl.run.task"]))
@pytest.mark.parametrize("number", first_of([signal.SIGINT, signal.SIGHUP]))
def test_a_signal_during_an_import_is_one_line(tmp_path, module, number):
    (tmp_path / "spec.yaml").write_text(QUICK)
    command = [sys.executable, "-X", "importtime", "-m", "tetractl", "run", "spec.yaml"]
    with subprocess.Popen(
        command, cwd=tmp_path, env=environment(), stderr=subprocess.PIPE, text=True
    ) as process:
        said = []
        for line in process.stderr:
            if re.search(rf"\| +{re.escape(module)}\b", line) and not said:
                process.send_signal(number)
            said += [] if line.startswith("import time:") else [line]
        assert process.wait(PATIENCE_S) == 130
    assert said == ["error: interrupted\n"]


@LINUX
@pytest.mark.system
@pytest.mark.parametrize("spec", [ENDLESS, HEAVY], ids=["endless", "heavy"])
def test_workers_end_with_their_parent(tmp_path, spec):
    """Regression: kill -9 of the parent left its workers for ever."""
    with Running(tmp_path, spec, "--jobs", "2") as running:
        running.until_logging(2)
        workers = running.workers()
        assert len(workers) == 2
        running.process.kill()
        running.process.wait()
        deadline = time.monotonic() + PATIENCE_S
        while any(map(is_worker, workers)):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        logs = sorted(running.logs.glob("*.mcap"))
        assert [read_result(log).outcome for log in logs] == ["interrupted"] * 2


@contextmanager
def stream(kind):
    """A descriptor to write to: a pipe or a terminal that takes nothing any more ("full"), or whose
    reader has gone ("closed"), or a full disk."""
    if kind == "full disk":
        ends = (os.open("/dev/full", os.O_WRONLY),)
    else:
        ends = os.pipe() if kind.endswith("pipe") else pty.openpty()
    if kind.startswith("closed"):
        os.close(ends[0])
    elif kind != "full disk":
        fill(ends[1])
    try:
        yield ends[-1]
    finally:
        for end in ends[1:] if kind.startswith("closed") else ends:
            os.close(end)


def fill(descriptor):
    before = fcntl.fcntl(descriptor, fcntl.F_SETFL, os.O_NONBLOCK | os.O_RDWR)
    with suppress(BlockingIOError):
        while True:
            os.write(descriptor, b"x" * 100)
    with suppress(BlockingIOError):
        while True:
            os.write(descriptor, b"x")
    fcntl.fcntl(descriptor, fcntl.F_SETFL, os.O_RDWR | before)
    assert not select.select([], [descriptor], [], 0)[1]


def started(folder, which, descriptor):
    """A run with one standard stream on `descriptor`, and the other one on a pipe."""
    (folder / "spec.yaml").write_text(QUICK)
    other = {"stdout": "stderr", "stderr": "stdout"}[which]
    streams = {which: descriptor, other: subprocess.PIPE}
    return subprocess.Popen(
        [TETRACTL, "run", "spec.yaml", "--out", "logs"],
        cwd=folder,
        env=environment(),
        text=True,
        stdin=subprocess.DEVNULL,
        **streams,
    )


@pytest.mark.parametrize("broken", first_of(["full disk", "closed pipe", "closed terminal"]))
@pytest.mark.parametrize("which", first_of(["stderr", "stdout"]))
def test_a_stream_that_fails_neither_hangs_nor_kills_a_run(tmp_path, broken, which):
    with stream(broken) as descriptor:
        process = started(tmp_path, which, descriptor)
        out, err = process.communicate(timeout=PATIENCE_S)
    assert len(list((tmp_path / "logs").glob("*.mcap"))) == 3
    told = which == "stdout" and broken != "closed pipe"
    assert process.returncode == (1 if told else 0), err
    if which == "stderr":
        assert "3 of 3 trials valid" in out
    else:
        assert "look at one with: tetractl replay logs/trial-000.mcap" in err


@pytest.mark.parametrize("full", first_of(["full pipe", "full terminal"]))
def test_a_signal_ends_a_run_whose_messages_nobody_reads(tmp_path, full):
    with stream(full) as descriptor:
        process = started(tmp_path, "stderr", descriptor)
        while not (tmp_path / "logs").exists() and process.poll() is None:
            with suppress(subprocess.TimeoutExpired):
                process.wait(0.02)
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130


@pytest.mark.parametrize("full", first_of(["full pipe", "full terminal"]))
def test_a_signal_leaves_out_the_results_that_nobody_reads(tmp_path, full):
    with stream(full) as descriptor:
        process = started(tmp_path, "stdout", descriptor)
        while "trial 3 of 3" not in process.stderr.readline():
            pass
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert "look at one with: tetractl replay logs/trial-000.mcap" in err


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with a spec, a study of it and the logs of a run."""
    folder = tmp_path_factory.mktemp("files")
    write(folder, SMALL)
    tetractl("run", "spec.yaml", "--out", "logs", cwd=folder).ok()
    return folder


LOG = "logs/trial-000.mcap"
ENDING = {  # every command that ends by itself and needs no lab, and its exit code
    "--help": 0,
    "--version": 0,
    "init made": 0,
    "run spec.yaml --out new": 0,
    "run spec.yaml --out new --json": 0,
    "run spec.yaml --out new --jobs 2": 0,
    "run spec.yaml --dry-run": 0,
    f"rerun {LOG} --out new": 0,
    "run": 2,
    "validate spec.yaml": 0,
    "schema": 0,
    "kinds": 0,
    f"info {LOG}": 0,
    f"recover {LOG}": 0,
    f"replay {LOG} --rate 100": 0,
    f"plot {LOG}": 0,
    "report logs": 0,
    "export logs -o tables": 0,
    "verify logs": 0,
    "stats logs": 0,
    "stats logs --format csv": 0,
    "analyze spec.yaml --plans 1": 0,
    "study study.yaml --out arms --jobs 2": 0,
    "identify logs": 0,
    "lab stop --port nowhere": 1,
}


@pytest.mark.parametrize("words", first_of(sorted(ENDING, key="stats logs".__ne__)))
def test_every_command_ends_though_nobody_reads_it(files, tmp_path, words):
    """Regression: `python -m tetractl stats`, unread, waited for ever for a thread that had ended.

    The installed script flushes once more before the interpreter ends; `python -m` does not.
    """
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    with stream("closed pipe") as descriptor:
        done = subprocess.run(
            [sys.executable, "-m", "tetractl", *words.split()],
            cwd=tmp_path,
            env=environment(),
            stdin=subprocess.DEVNULL,
            stdout=descriptor,
            stderr=descriptor,
            timeout=PATIENCE_S,
        )
    assert done.returncode == ENDING[words]

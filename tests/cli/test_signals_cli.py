"""Tests of signals to real processes, and of terminals and pipes that vanish or get stuck."""

import os
import pty
import select
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

import pytest
from testkit.running import (
    ENDLESS,
    HEAVY,
    PATIENCE_S,
    QUICK,
    Running,
    assert_interrupted,
    environment,
    first_of,
    is_worker,
)
from testkit.studies import SMALL, tetractl, write

from tetractl.log.read.reader import read_result

pytestmark = pytest.mark.long

NAMES = ["SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGUSR1", "SIGALRM", "SIGABRT", "SIGRTMIN"]
MODULES = ["numba", "typer", "pydantic", "tetractl.run.task"]
LINUX = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs Linux's /proc")


@pytest.mark.parametrize("name", first_of(NAMES, also=["SIGTERM"]))
def test_every_signal_finishes_the_step_and_the_log(tmp_path, name):
    with Running(tmp_path, ENDLESS) as running:
        running.until_logging(1, size=30_000)
        running.process.send_signal(getattr(signal, name))
        assert running.end() == 130
        assert_interrupted(running, 1, "interrupted; the control step was finished first")


@pytest.mark.parametrize("module", first_of(MODULES, also=["tetractl.run.task"]))
@pytest.mark.parametrize("number", first_of([signal.SIGINT, signal.SIGHUP]))
def test_a_signal_during_an_import_is_one_line(tmp_path, module, number):
    """Sent once, after the first part of the module; importtime writes a line after each."""
    (tmp_path / "spec.yaml").write_text(QUICK)
    command = [sys.executable, "-X", "importtime", "-m", "tetractl", "run", "spec.yaml"]
    with subprocess.Popen(
        command, cwd=tmp_path, env=environment(), stderr=subprocess.PIPE, bufsize=0
    ) as process:
        lines = []
        for line in process.stderr:  # not buffered: `communicate` reads what comes after
            lines.append(line.decode())
            imported = lines[-1].rpartition("|")[2].strip()
            if f"{imported}.".startswith(f"{module}."):
                break
        process.send_signal(number)
        _, rest = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    lines += rest.decode().splitlines(keepends=True)
    said = [line for line in lines if not line.startswith("import time:")]
    assert said == ["error: interrupted\n"]


@LINUX
@pytest.mark.system
def test_workers_end_with_their_parent(tmp_path):
    """Regression: kill -9 of the parent left its workers for ever. They plan for minutes."""
    with Running(tmp_path, HEAVY, "--jobs", "2") as running:
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


# ---- Standard streams that fail ----


@contextmanager
def closed(open_pair):
    """The writer's end of a pipe or terminal whose reader has gone."""
    reader, writer = open_pair()
    os.close(reader)
    try:
        yield writer
    finally:
        os.close(writer)


@contextmanager
def full(open_pair, room=0):
    """The writer's end of a pipe or terminal that is not read and takes nothing more, a pipe
    `room` bytes."""
    reader, writer = open_pair()
    fill(writer)
    if room:
        os.read(reader, room)
    try:
        yield writer
    finally:
        os.close(reader)
        os.close(writer)


def fill(descriptor):
    """Write until not even one more byte is taken."""
    os.set_blocking(descriptor, False)
    for size in (100, 1):
        with suppress(BlockingIOError):
            while True:
                os.write(descriptor, b"x" * size)
    os.set_blocking(descriptor, True)
    assert is_full(descriptor)


def is_full(descriptor):
    _, writable, _ = select.select([], [descriptor], [], 0)
    return not writable


@contextmanager
def full_disk():
    """A file on a disk without space."""
    descriptor = os.open("/dev/full", os.O_WRONLY)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


BROKEN = {
    "full disk": full_disk,
    "closed pipe": partial(closed, os.pipe),
    "closed terminal": partial(closed, pty.openpty),
}
FULL = {
    "full pipe": partial(full, os.pipe),
    "full terminal": partial(full, pty.openpty),
}


def quick_run(folder, *args, **streams):
    """A run of three trials with `streams`; what goes to no stream goes to files."""
    return Running(folder, QUICK, *args, stdin=subprocess.DEVNULL, **streams)


@pytest.mark.parametrize("broken", first_of(BROKEN))
@pytest.mark.parametrize(
    ("stream", "other", "says"),
    [
        ("stderr", "out", "3 of 3 trials valid"),
        ("stdout", "err", "look at one of them with: tetractl replay logs/trial-000.mcap"),
    ],
    ids=["messages", "results"],
)
def test_results_that_cannot_be_written_are_an_error_unless_their_reader_ended(
    tmp_path, broken, stream, other, says
):
    """Messages that cannot be written change nothing."""
    with BROKEN[broken]() as descriptor, quick_run(tmp_path, **{stream: descriptor}) as running:
        is_error = stream == "stdout" and broken != "closed pipe"
        assert running.end() == is_error
    assert len(list(running.logs.glob("*.mcap"))) == 3
    assert says in getattr(running, other).read_text()


@pytest.mark.parametrize("unread", first_of(FULL))
def test_a_signal_ends_a_run_whose_messages_nobody_reads(tmp_path, unread):
    with FULL[unread]() as descriptor, quick_run(tmp_path, stderr=descriptor) as running:
        running.until(running.logs.exists)
        running.process.send_signal(signal.SIGTERM)
        assert running.end() == 130


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with a spec, a study of it and the logs of a run."""
    folder = tmp_path_factory.mktemp("files")
    write(folder, SMALL)
    tetractl("run", "spec.yaml", "--out", "logs", cwd=folder).ok()
    return folder


LOG = "logs/trial-000.mcap"
ENDING = {  # every command that ends by itself and needs no lab, and its exit code
    "stats logs": 0,  # the first: the only one of `make test`
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
    "stats logs --format csv": 0,
    "analyze spec.yaml --trials 1": 0,
    "study study.yaml --out arms --jobs 2": 0,
    "identify logs": 0,
    "lab stop --port nowhere": 1,
}
OF_THREADS = (  # what is done in threads or processes; the others write as `stats` does
    "run spec.yaml --out new --jobs 2",
    f"replay {LOG} --rate 100",
    "study study.yaml --out arms --jobs 2",
)


@pytest.mark.parametrize("words", first_of(ENDING, also=OF_THREADS))
def test_every_command_ends_though_nobody_reads_it(files, tmp_path, words):
    """Regression: `python -m tetractl stats`, unread, waited for ever for a thread that had ended.

    The installed script flushes once more before the interpreter ends; `python -m` does not.
    """
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    with closed(os.pipe) as descriptor:
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


@pytest.mark.system
@pytest.mark.parametrize(("spec", "jobs"), [(ENDLESS, "1"), (HEAVY, "2")], ids=["endless", "heavy"])
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
        assert lines[-2].startswith("logs are in logs")
        assert (
            lines[-1]
            == "interrupted; to continue, run the same command again with --out logs --resume"
        )


PAGE = 4096  # bytes, fewer than the results of six trials as JSON; pipes are filled by pages


def test_a_signal_leaves_out_the_results_that_nobody_reads(tmp_path):
    with (
        full(os.pipe, room=PAGE) as descriptor,
        quick_run(tmp_path, "--json", "--set", "trials.count=6", stdout=descriptor) as running,
    ):
        assert not is_full(descriptor)
        running.until(lambda: is_full(descriptor))  # with results: nothing else goes there
        running.process.send_signal(signal.SIGINT)
        assert running.end() == 0
    assert (
        "look at one of them with: tetractl replay logs/trial-000.mcap" in running.err.read_text()
    )

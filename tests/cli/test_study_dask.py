"""A study on a real Dask scheduler with two workers on loopback, one of which is killed."""

import json
import subprocess
import sys
from contextlib import ExitStack, contextmanager, suppress

import pytest
from support.running import PATIENCE_S, environment
from support.studies import LONGER, Running, results, rows, tetractl, write

from tetractl.log.read.reader import content_digest

pytest.importorskip("distributed")


@contextmanager
def dask(command, *args, cwd):
    """A process of Dask's own, killed at the end."""
    with (cwd / f"{command}.log").open("ab") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.dask_{command}", "--no-dashboard", *args],
            cwd=cwd,
            env=environment(),
            stdout=log,
            stderr=log,
        )
        try:
            yield process
        finally:
            process.kill()
            process.wait(PATIENCE_S)


@contextmanager
def cluster(cwd):
    """Yield the address of a scheduler and the processes of its two workers."""
    file = cwd / "scheduler.json"
    with ExitStack() as stack:
        args = ["--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file)]
        scheduler = stack.enter_context(dask("scheduler", *args, cwd=cwd))
        while not (file.exists() and file.read_bytes().endswith(b"}")):
            assert scheduler.poll() is None, (cwd / "scheduler.log").read_text()
            with suppress(subprocess.TimeoutExpired):
                scheduler.wait(0.05)
        address = json.loads(file.read_text())["address"]
        one = ["--nthreads", "1", "--no-nanny", "--local-directory", str(cwd), address]
        yield address, [stack.enter_context(dask("worker", *one, cwd=cwd)) for _ in range(2)]


@pytest.mark.slow
def test_a_study_on_a_cluster_that_loses_a_worker_gives_the_same_table(tmp_path):
    write(tmp_path, LONGER)
    done = tetractl("study", "study.yaml", "--out", "here", "--jobs", 2, "-q", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    out = tmp_path / "there"
    with cluster(tmp_path) as (address, workers):
        args = ["study.yaml", "--out", out, "--cluster", address]
        with Running(tmp_path, *args) as running:
            running.until_rows(out, 10)
            workers[0].kill()
            assert running.end() == 0, running.err.read_text()
    assert rows(out) == 96
    assert results(out) == results(tmp_path / "here")
    for path in sorted(out.rglob("*.mcap"))[::17]:
        assert content_digest(path) == content_digest(tmp_path / "here" / path.relative_to(out))


@pytest.mark.slow
def test_an_address_without_a_scheduler_is_told(tmp_path):
    write(tmp_path)
    done = tetractl("study", "study.yaml", "--cluster", "nonsense", cwd=tmp_path)
    assert done.returncode == 2
    assert "nonsense: no Dask scheduler answers there" in done.stderr

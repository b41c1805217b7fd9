"""Tests of a study on a real local Dask scheduler with two workers that are killed."""

import json
import shutil
import subprocess
import sys
from contextlib import ExitStack, contextmanager, suppress
from importlib.util import find_spec

import pytest
from testkit.cli import process
from testkit.running import PATIENCE_S, environment
from testkit.studies import SMALL, STUDY, Running, logs, results, tetractl, write

from tetractl.log.read.reader import content_digest

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(find_spec("distributed") is None, reason="distributed is not installed"),
]


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
def cluster(cwd, *security, scheme="tcp"):
    """Yield the address of a scheduler, its process and those of its two workers."""
    file = cwd / "scheduler.json"
    file.unlink(missing_ok=True)
    with ExitStack() as stack:
        args = ["--host", f"{scheme}://127.0.0.1", "--port", "0", "--scheduler-file", str(file)]
        args += security
        scheduler = stack.enter_context(dask("scheduler", *args, cwd=cwd))
        while not (file.exists() and file.read_bytes().endswith(b"}")):
            assert scheduler.poll() is None, (cwd / "scheduler.log").read_text()
            with suppress(subprocess.TimeoutExpired):
                scheduler.wait(0.05)
        address = json.loads(file.read_text())["address"]
        args = ["--nthreads", "1", "--no-nanny", "--local-directory", str(cwd), *security, address]
        workers = [stack.enter_context(dask("worker", *args, cwd=cwd)) for _ in range(2)]
        yield address, scheduler, workers


def test_a_study_outlives_a_worker_and_by_the_same_command_a_scheduler(tmp_path):
    write(tmp_path, STUDY.replace("count: 5", "count: 8"))
    tetractl("study", "study.yaml", "--out", "here", "--jobs", 1, "-q", cwd=tmp_path).ok()
    here = tmp_path / "here"
    there = tmp_path / "there"
    with cluster(tmp_path) as (address, scheduler, workers):
        args = ("--out", there, "--cluster", address, "-q")
        with Running(tmp_path, "study.yaml", *args) as running:
            running.until_logs(there, 10)
            workers[0].kill()
            running.until_logs(there, logs(there) + 10)
            scheduler.kill()
            assert running.end() == 1
    assert running.err.read_text() == (
        f"error: {address}: the scheduler does not answer any more; all results so far are stored\n"
        "hint: to continue, start a scheduler, and run the same command again with its address\n"
    )
    assert 20 <= logs(there) < 64
    with cluster(tmp_path) as (address, _, _):
        args = ("--out", there, "--cluster", address, "-q")
        tetractl("study", "study.yaml", *args, cwd=tmp_path).ok()
    assert logs(there) == 64
    assert results(there) == results(here)
    for path in sorted(there.rglob("*.mcap"))[::17]:
        assert content_digest(path) == content_digest(here / path.relative_to(there))


def certificates(folder):
    """Write a certificate of its own authority and return the files: authority, certificate,
    key."""
    ca = str(folder / "ca.pem")
    ca_key = str(folder / "ca.key")
    certificate = str(folder / "own.pem")
    key = str(folder / "own.key")
    request = str(folder / "own.csr")
    new = ["openssl", "req", "-newkey", "rsa:2048", "-nodes", "-subj"]
    sign = ["openssl", "x509", "-req", "-CAcreateserial", "-days", "9"]
    for words in (
        [*new, "/CN=authority", "-x509", "-days", "9", "-keyout", ca_key, "-out", ca],
        [*new, "/CN=study", "-keyout", key, "-out", request],
        [*sign, "-in", request, "-CA", ca, "-CAkey", ca_key, "-out", certificate],
    ):
        subprocess.run(words, check=True, capture_output=True)
    return ca, certificate, key


@pytest.mark.release  # what refuses is Dask
@pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl for certificates")
def test_a_cluster_with_tls_takes_only_who_has_a_certificate(tmp_path, monkeypatch):
    write(tmp_path, SMALL)
    ca, certificate, key = certificates(tmp_path)
    security = ("--tls-ca-file", ca, "--tls-cert", certificate, "--tls-key", key)
    with cluster(tmp_path, *security, scheme="tls") as (address, _, _):
        args = ("study.yaml", "--out", "there", "-q", "--cluster")
        done = tetractl("study", *args, address, cwd=tmp_path)
        assert done.returncode == 2
        assert (
            f"{address}: the address needs TLS, but Dask is configured without a certificate"
            in done.stderr
        )
        done = tetractl("study", *args, address.replace("tls:", "tcp:"), cwd=tmp_path)
        assert done.returncode == 2
        assert "no Dask scheduler answers at this address" in done.stderr
        assert logs(tmp_path / "there") == 0
        tls = "DASK_DISTRIBUTED__COMM__TLS__"
        for name, file in (("CA_FILE", ca), ("CLIENT__CERT", certificate), ("CLIENT__KEY", key)):
            monkeypatch.setenv(tls + name, file)
        # Dask reads them when it is imported: in a process of its own
        process(tmp_path, "study", *args, address).ok()
        assert logs(tmp_path / "there") == 6


def test_an_address_without_a_scheduler_is_told(tmp_path):
    write(tmp_path)
    done = tetractl("study", "study.yaml", "--cluster", "nonsense", cwd=tmp_path)
    assert done.returncode == 2
    assert "nonsense: no Dask scheduler answers at this address" in done.stderr

"""A study on a real Dask scheduler with two workers on loopback, one of which is killed."""

import json
import shutil
import subprocess
import sys
from contextlib import ExitStack, contextmanager, suppress

import pytest
from support.cli import process
from support.running import PATIENCE_S, environment
from support.studies import LONGER, SMALL, Running, logs, results, tetractl, write

from tetractl.log.read.reader import content_digest

pytestmark = pytest.mark.system

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


@pytest.fixture(scope="module")
def local_study(tmp_path_factory):
    """The folder of the longer study run in this process."""
    folder = tmp_path_factory.mktemp("here")
    write(folder, LONGER)
    tetractl("study", "study.yaml", "--out", "here", "--jobs", 1, "-q", cwd=folder).ok()
    return folder / "here"


def test_a_study_on_a_cluster_that_loses_a_worker_gives_the_same_table(tmp_path, local_study):
    write(tmp_path, LONGER)
    out = tmp_path / "there"
    with cluster(tmp_path) as (address, _, workers):
        args = ["study.yaml", "--out", out, "--cluster", address]
        with Running(tmp_path, *args) as running:
            running.until_logs(out, 10)
            workers[0].kill()
            assert running.end() == 0, running.err.read_text()
    assert logs(out) == 96
    assert results(out) == results(local_study)
    for path in sorted(out.rglob("*.mcap"))[::17]:
        assert content_digest(path) == content_digest(local_study / path.relative_to(out))


def test_a_scheduler_that_goes_in_mid_study_fails_no_trial_and_the_same_command_goes_on(
    tmp_path, local_study
):
    write(tmp_path, LONGER)
    out = tmp_path / "there"
    with cluster(tmp_path) as (address, scheduler, _):
        args = ("--out", out, "--cluster", address, "-q")
        with Running(tmp_path, "study.yaml", *args) as running:
            running.until_logs(out, 10)
            scheduler.kill()
            assert running.end() == 1
    assert running.err.read_text() == (
        f"error: {address}: the scheduler is gone; results so far are stored\n"
        "hint: start a scheduler, and give the same command with its address to continue\n"
    )
    assert 10 <= logs(out) < 96
    with cluster(tmp_path) as (address, _, _):
        args = ("--out", out, "--cluster", address, "-q")
        tetractl("study", "study.yaml", *args, cwd=tmp_path).ok()
    assert logs(out) == 96
    assert results(out) == results(local_study)


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
        assert f"{address}: Dask is configured with no certificate for TLS" in done.stderr
        done = tetractl("study", *args, address.replace("tls:", "tcp:"), cwd=tmp_path)
        assert done.returncode == 2
        assert "no Dask scheduler answers there" in done.stderr
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
    assert "nonsense: no Dask scheduler answers there" in done.stderr

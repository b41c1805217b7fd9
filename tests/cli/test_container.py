"""Tests of the steps in the `Containerfile`, in a clean root folder without a container runtime."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from testkit.paths import ROOT

pytestmark = [
    pytest.mark.slow,
    pytest.mark.system,
    pytest.mark.release,
    pytest.mark.skipif(os.geteuid() != 0, reason="only root can change the root folder"),
    pytest.mark.skipif(not shutil.which("debootstrap"), reason="debootstrap is not installed"),
]
CHROOT = shutil.which("chroot") or "chroot"  # the container's PATH may lack its folder
NETWORK_FILES = ("etc/resolv.conf", "etc/pip.conf", "etc/ssl/certs/ca-certificates.crt")
"""Files by which programs reach the network here."""


def instructions():
    """Return the instructions of the Containerfile, each as its name and its text."""
    text = (ROOT / "Containerfile").read_text()
    text = re.sub(r"(?m)^#.*\n", "", text).replace("\\\n", " ")
    return [line.split(maxsplit=1) for line in text.splitlines() if line.strip()]


def copy_network_files(root):
    for name in NETWORK_FILES:
        if Path("/", name).exists():
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(Path("/", name), root / name)


@pytest.fixture(scope="module")
def container(tmp_path_factory):
    """A function that runs a command where the Containerfile's steps have been run."""
    root = tmp_path_factory.mktemp("root")
    folder, environment = "/", {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "HOME": "/root"}
    environment |= {name: value for name, value in os.environ.items() if name.startswith("PIP_")}

    def run(*command):
        entered = [CHROOT, str(root), "/bin/sh", "-c", 'cd "$0" && exec "$@"', folder, *command]
        done = subprocess.run(entered, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    for name, text in instructions():
        if name == "FROM":
            suite = re.fullmatch(r"debian:(\w+)-slim", text)[1]
            subprocess.run(
                ["debootstrap", "--variant=minbase", suite, str(root)],
                check=True,
                stdout=subprocess.DEVNULL,
            )
            copy_network_files(root)
        elif name == "RUN":
            run("/bin/sh", "-c", text)
            copy_network_files(root)  # installing certificates replaces the file of this computer
        elif name == "WORKDIR":
            folder = text
            (root / folder[1:]).mkdir()
        elif name == "COPY":
            assert text == ". ."
            for file in subprocess.check_output(["git", "ls-files"], cwd=ROOT, text=True).split():
                copy = root / folder[1:] / file
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(ROOT / file, copy)
        elif name == "ENV":
            key, _, value = text.partition("=")
            environment[key] = value
        else:
            assert name == "CMD"
    return run


def test_it_runs_the_reference_experiment(container):
    assert instructions()[-1] == ["CMD", '["make", "demo"]']
    printed = container("make", "demo")
    assert "logs/demo/report.html" in printed
    assert "logs/demo/play.html" in printed


def test_it_runs_the_emulated_lab(container):
    spec = "experiments/three_m3pi_lab.yaml"
    run = ["run", spec, "--plant", "emulated", "--trials", "1", "--yes", "--out", "logs/lab"]
    container("tetractl", *run)
    assert "three-m3pi-lab" in container("tetractl", "info", "logs/lab/trial-000.mcap")

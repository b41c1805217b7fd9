"""A wheel, built and installed into an empty environment, does what a user does first."""

import json
import os
import subprocess
import sys
import sysconfig
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest
from support.paths import EMULATOR, ROOT

pytestmark = pytest.mark.system


def run(folder, *words, code=0, env=None):
    inherited = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "_TETRACTL"))}
    done = subprocess.run(
        list(map(str, words)),
        cwd=folder,
        env=inherited | {"COLUMNS": "100"} | (env or {}),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


def built(place, source, name):
    """Build the wheel of a package; return its path."""
    build = ["-m", "pip", "wheel", "--quiet", "--no-deps", "-w", place, source]
    if find_spec("hatchling"):  # else pip fetches it
        build.insert(3, "--no-build-isolation")
    run(place, sys.executable, *build)
    (wheel,) = place.glob(f"{name}-*.whl")
    return wheel


def install(python, wheel):
    pip = [sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", wheel]
    run(wheel.parent, *pip)


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The environment's folder of commands. What tetractl needs is that of this environment."""
    place = tmp_path_factory.mktemp("wheel")
    wheel = built(place, ROOT, "tetractl")
    run(place, sys.executable, "-m", "venv", "--without-pip", "empty")
    python = place / "empty" / "bin" / "python"
    where = run(place, python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))")
    packages = place / where.strip()
    install(python, wheel)
    libraries = Path(sysconfig.get_path("purelib"))
    for library in libraries.iterdir():  # all but ours, whose commands would be found as well
        if not library.name.startswith(("tetractl", "_editable_impl_tetractl")):
            (packages / library.name).symlink_to(library)
    said = run(place, python, "-c", "import tetractl; print(tetractl.__file__)")
    assert said.strip().startswith(str(packages)), said
    return python.parent


def test_the_wheel_holds_the_examples_and_no_tests(installed):
    (wheel,) = installed.parents[1].glob("tetractl-*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert "tetractl/experiments/three_m3pi.yaml" in names
    outside = ("tests/", "docs/", "packages/", "tools/")
    assert not [name for name in names if name.startswith(outside)]


@pytest.mark.release  # CI compiles for a plug-in, with an empty cache too: test_plugin_models.py
def test_it_runs_a_trial_and_a_report(installed, tmp_path):
    tetractl = installed / "tetractl"
    assert run(tmp_path, tetractl, "--version").startswith("tetractl ")
    run(tmp_path, tetractl, "init", "--example", "three_m3pi")
    words = ("experiments/three_m3pi.yaml", "--trials", 1, "--out", "logs", "--quiet")
    assert "1 of 1 trials valid" in run(tmp_path, tetractl, "run", *words)
    assert run(tmp_path, tetractl, "report", "logs") == "report.html\n"
    assert "trial-data-0" in (tmp_path / "report.html").read_text()
    assert "ok" in run(tmp_path, tetractl, "verify", "logs")


@pytest.mark.release  # of a second wheel; from the clone, the lab is checked on the same wires
def test_it_checks_an_emulated_lab_once_the_emulator_is_installed(installed, tmp_path):
    tetractl = installed / "tetractl"
    run(tmp_path, tetractl, "init", "--example", "three_m3pi_lab")
    lacks = (
        "tetractl-emulator, which is not installed\nhint: pip install ./packages/tetractl-emulator"
    )
    words = "experiments/three_m3pi_lab.yaml", "--plant", "emulated"
    assert lacks in run(tmp_path, tetractl, "run", *words, code=2)
    assert lacks in run(tmp_path, tetractl, "lab", "emulate", words[0], code=2)
    wheel = built(installed.parents[1], EMULATOR, "tetractl_emulator")
    assert "tetractl_emulator/cores/m3pi_core.c" in zipfile.ZipFile(wheel).namelist()
    install(installed / "python", wheel)
    port = tmp_path / "radio"
    spec = ["experiments/three_m3pi_lab.yaml", "--set", f"lab.actuator.port={port}"]
    for setting in ("server=127.0.0.1", "interface=127.0.0.1", "transport=unicast"):
        spec += ["--set", f"lab.camera.{setting}"]
    ports = ("--command-port", "0", "--data-port", "0")
    lab = subprocess.Popen(
        [*map(str, (tetractl, "lab", "emulate", *spec, *ports, "--json"))],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        ready = json.loads(lab.stdout.readline())
        assert ready["event"] == "ready"
        for name in ("command_port", "data_port"):
            spec += ["--set", f"lab.camera.{name}={ready[name]}"]
        said = run(tmp_path, tetractl, "lab", "check", *spec, "--yes")
        assert "emulated" in said.lower()
    finally:
        lab.terminate()
        lab.wait(600)
        lab.stdout.close()

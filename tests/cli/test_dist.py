"""Tests of `make dist` in an empty environment: packages work, and nothing is compiled."""

import os
import platform
import re
import shlex
import subprocess
import sys

import console
import pytest
from testkit.paths import ROOT

pytestmark = [pytest.mark.slow, pytest.mark.system, pytest.mark.release]

RUN = """
import sys
from tetractl.tools.cache import compiling
from tetractl.cli import main

def fail():
    sys.exit("a kernel was compiled")

compiling.append(fail)
main()
"""


PAGES = ("README.md", "docs/tutorial.md")
SHELL_BLOCK = re.compile(r"^```sh\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def done(*command, folder=ROOT / "docs", **variables):
    """Run a command away from the sources, which it would import; return what it printed."""
    environment = os.environ | variables
    ended = subprocess.run(
        [*map(str, command)], cwd=folder, env=environment, capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


@pytest.fixture(scope="module")
def python(tmp_path_factory):
    """The interpreter of an empty environment into which the wheels were installed."""
    wheels = tmp_path_factory.mktemp("wheels")
    place = tmp_path_factory.mktemp("environment")
    done(sys.executable, ROOT / "tools/dist.py", wheels)
    pure = next(wheels.glob("tetractl-*-none-any.whl"))
    core = next(wheels.glob("tetractl-*-cp*.whl"), pure)
    others = {
        wheel.name.partition("-")[0]: wheel
        for wheel in wheels.glob("*.whl")
        if wheel not in (core, pure)
    }
    packages = [path.parent.name for path in (ROOT / "packages").glob("*/pyproject.toml")]
    assert sorted(others) == sorted(name.replace("-", "_") for name in packages)
    archives = [archive.name.partition("-")[0] for archive in wheels.glob("*.tar.gz")]
    assert sorted(archives) == sorted(["tetractl", *others])
    # the package that has files from outside its folder is installed from its archive
    others["tetractl_emulator"] = next(wheels.glob("tetractl_emulator-*.tar.gz"))
    done(sys.executable, "-m", "venv", place)
    python = place / "bin" / "python"
    install = (python, "-m", "pip", "install", "--quiet", "-c", ROOT / "constraints.txt")
    done(*install, core, *others.values())
    return python


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the wheel has no compiled code")
@pytest.mark.parametrize("spec", ["three_m3pi_bench", "three_m3pi_paper"])
def test_a_trial_from_the_wheel_compiles_nothing_and_decides_the_same(python, tmp_path, spec):
    path = ROOT / f"experiments/{spec}.yaml"
    cache = tmp_path / "cache"
    run = ("run", path, "--trials", "1", "--quiet", "--out")
    done(python, "-c", RUN, *run, tmp_path / "wheel", TETRACTL_CACHE_DIR=str(cache))
    assert list(cache.rglob("*.kernel")) == []
    done(sys.executable, "-m", "tetractl", *run, tmp_path / "source")
    digests = {
        done(sys.executable, "-c", DIGEST, tmp_path / name / "trial-000.mcap")
        for name in ("wheel", "source")
    }
    assert len(digests) == 1


DIGEST = """
import sys
from pathlib import Path
from tetractl.log.read.reader import content_digest
print(content_digest(Path(sys.argv[1])))
"""


def test_the_other_packages_are_found_and_run(python, tmp_path):
    kinds = done(python, "-m", "tetractl", "kinds")
    assert "apriltag" in kinds and "emulated" in kinds
    spec = ROOT / "experiments/three_m3pi_lab.yaml"
    run = ("run", spec, "--plant", "emulated", "--trials", "1", "--yes", "--quiet")
    done(python, "-m", "tetractl", *run, "--out", tmp_path / "emulated")
    assert (tmp_path / "emulated" / "trial-000.mcap").exists()


@pytest.mark.parametrize("page", PAGES)
def test_every_command_of_a_page_prints_the_same_without_a_checkout(python, page):
    text = (ROOT / page).read_text("utf-8")
    exact = console.exact(text)
    for example, printed, code in console.run(text, python.parent):
        assert console.agrees(example.shown, printed, exact), f"$ {example.command}\n{printed}"
        assert code == 0 or example.shown, f"$ {example.command}\nexit code {code}\n{printed}"


@pytest.mark.parametrize("page", PAGES)
def test_every_command_that_a_page_only_names_runs_without_a_checkout(python, page, tmp_path):
    """Batches are cut to one trial; what a person plays is left out."""
    text = (ROOT / page).read_text("utf-8")
    console.write_examples(text, tmp_path, python.parent)
    for block in SHELL_BLOCK.findall(text):
        for line in block.splitlines():
            words = shlex.split(line, comments=True)
            if words[:1] != ["tetractl"] or words[1] == "play":
                continue
            if words[1] == "run":
                words += ["--trials", "1", "--quiet"]
            done(python.parent / "tetractl", *words[1:], folder=tmp_path)
    for number, program in enumerate(console.programs(text)):
        (tmp_path / f"{number}.py").write_text(program)
        done(python, f"{number}.py", folder=tmp_path)

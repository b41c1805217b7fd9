"""Tests of the contents of the package's wheel."""

import os
import subprocess
import sys
import zipfile
from importlib.util import find_spec

import pytest
from testkit.paths import ROOT

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


def test_the_wheel_holds_the_examples_and_no_tests(tmp_path):
    """What is installed of it runs trials and labs: test_dist.py."""
    build = ["-m", "pip", "wheel", "--quiet", "--no-deps", "-w", tmp_path, ROOT]
    if find_spec("hatchling"):  # else pip fetches it
        build.insert(3, "--no-build-isolation")
    subprocess.run([sys.executable, *build], check=True, timeout=600)
    (wheel,) = tmp_path.glob("tetractl-*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert "tetractl/experiments/three_m3pi.yaml" in names
    outside = ("tests/", "docs/", "packages/", "tools/")
    assert not [name for name in names if name.startswith(outside)]

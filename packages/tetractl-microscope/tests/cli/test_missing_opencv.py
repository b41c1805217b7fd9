"""Tests that commands which draw images say in one line what to install if OpenCV is missing."""

import subprocess
import sys

import pytest
from testkit.paths import EXAMPLES

pytestmark = pytest.mark.long

MISSING = """
import sys
sys.modules["cv2"] = None  # as if it were not installed
from tetractl.cli.app import run_app
sys.exit(run_app())
"""


def test_a_missing_opencv_is_named_in_one_line(tmp_path):
    words = "lab", "emulate", EXAMPLES / "tetrahymena_dish.yaml", "--port-link", "coils"
    done = subprocess.run(
        [sys.executable, "-c", MISSING, *words], cwd=tmp_path, capture_output=True, text=True
    )
    error, hint = done.stderr.splitlines()[-2:]
    assert error.startswith("error: ") and error.endswith("which is not installed")
    assert "pip install ./packages/tetractl-microscope" in hint
    assert done.returncode in (1, 2)
    assert "Traceback" not in done.stderr

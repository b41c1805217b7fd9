"""The benchmarks that print the tables of the docs run, at their smallest size."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]
SMALLEST = [
    ("disturbed.py", "--part", "knowledge", "--trials", "1"),
    ("floors.py", "--trials", "1", "--rows", "0"),
    ("anywhere.py", "--trials", "1"),
    ("bodies.py", "--rate", "5", "--trials", "1"),
    ("unmodelled.py", "--trials", "1", "--world", "base"),
    ("solver.py", "--quick", "--only", "b"),
    ("side_by_side.py", "--trials", "4", "--rounds", "1"),
]


@pytest.mark.parametrize("given", SMALLEST, ids=lambda given: given[0])
def test_a_benchmark_prints_its_table(given):
    """Regression: three of these had followed no change of the controller's arguments."""
    name, *arguments = given
    command = [sys.executable, f"benchmarks/{name}", *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("\n|") >= 3

"""Tests that a command imports only few modules before it starts, because each one delays it."""

import subprocess
import sys

import pytest
from testkit.paths import ROOT

COUNTED = """
import atexit, sys
from tetractl.cli import main
sys.argv[0] = "tetractl"
ours = lambda: [name for name in sys.modules if name.partition(".")[0] == "tetractl"]
atexit.register(lambda: print(len(ours()), file=sys.stderr))
main()
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ("words", "most"),
    [(["--help"], 43), (["stats", ROOT / "tests" / "golden" / "format-4-sim.mcap"], 118)],
    ids=["help", "stats"],
)
def test_few_modules_are_imported(words, most):
    done = subprocess.run(
        [sys.executable, "-c", COUNTED, *words], capture_output=True, text=True, check=True
    )
    assert int(done.stderr.split()[-1]) <= most, done.stderr

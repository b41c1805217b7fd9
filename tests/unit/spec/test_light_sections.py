"""Tests that specs are checked without importing compiled code or image libraries."""

import subprocess
import sys

import pytest
from testkit.paths import ROOT

CHECK = """
import sys
from pathlib import Path
from tetractl.core.registries import SPEC_REGISTRIES
from tetractl.spec.load import load_spec
from tetractl.spec.experiment import Experiment
from tetractl.spec.schema import schema_of
for registry in SPEC_REGISTRIES:
    for name in registry.names():
        registry.load(name)
schema_of(Experiment)
load_spec(Path(sys.argv[1]))
print(sorted({"numba", "matplotlib", "cv2", "serial", "scipy"} & set(sys.modules)))
"""


@pytest.mark.long
def test_no_section_imports_what_is_heavy():
    done = subprocess.run(
        [sys.executable, "-c", CHECK, ROOT / "experiments/three_m3pi.yaml"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "[]\n"

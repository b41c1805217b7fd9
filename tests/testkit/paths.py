"""Paths in the source checkout."""

from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).parents[2]
MICROSCOPE = ROOT / "packages" / "tetractl-microscope"
EMULATOR = ROOT / "packages" / "tetractl-emulator"
FIRMWARE = ROOT / "firmware"
SCRIPTS = EMULATOR / "tetractl_emulator/examples/faults"
EXAMPLES = MICROSCOPE / "tetractl_microscope/examples"
SPECS = sorted((ROOT / "experiments").glob("*.yaml"))
"""The specs that we ship, those of the microscope too if it is installed."""
if find_spec("tetractl_microscope"):
    SPECS += sorted(EXAMPLES.glob("*.yaml"))
SOURCE_FOLDERS = (
    "benchmarks",
    "docs",
    "examples",
    "experiments",
    "firmware",
    "packages",
    "tests",
    "tetractl",
    "tools",
)
"""Folders of the repository that have files written by hand."""

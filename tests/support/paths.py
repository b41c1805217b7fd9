"""Where the checkout is."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
MICROSCOPE = ROOT / "packages" / "tetractl-microscope"
EMULATOR = ROOT / "packages" / "tetractl-emulator"
SCRIPTS = EMULATOR / "tetractl_emulator/examples/faults"
EXAMPLES = MICROSCOPE / "tetractl_microscope/examples"
SPECS = sorted((ROOT / "experiments").glob("*.yaml")) + sorted(EXAMPLES.glob("*.yaml"))
"""The specs that we ship, those of the microscope too."""

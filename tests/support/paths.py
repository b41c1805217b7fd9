"""Where the checkout is."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
MICROSCOPE = ROOT / "packages" / "tetractl-microscope"
EMULATOR = ROOT / "packages" / "tetractl-emulator"
SCRIPTS = EMULATOR / "faults"

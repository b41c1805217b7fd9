"""Puts the robots' firmware, which lies in the clone's `firmware/`, into archive and wheel."""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

CORES = ("field_core", "framing", "m3pi_core", "twist_core")


class FirmwareHook(BuildHookInterface):
    """Called by hatchling. A source archive has the files already, so its wheel needs no clone."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the sources that are compiled for this computer, if this is a clone.

        Args:
            version: "standard", or "editable" for a package that is run from the clone.
            build_data: What hatchling builds; gets the files as `force_include`.
        """
        firmware = Path(self.root).parents[1] / "firmware"
        if not firmware.is_dir():
            return
        for name in (f"{core}.{suffix}" for core in CORES for suffix in ("c", "h")):
            build_data["force_include"][str(firmware / name)] = f"tetractl_emulator/cores/{name}"

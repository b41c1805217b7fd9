"""Packages in this repository that are installed apart, and what each brings: a name that is not
installed is answered by the command that installs it.
"""

MICROSCOPE, EMULATOR = "tetractl-microscope", "tetractl-emulator"
BRINGS = {
    ("tetractl.plants", "emulated"): EMULATOR,
    ("tetractl.lab_commands", "emulate"): EMULATOR,
    ("tetractl.lab_commands", "survey"): MICROSCOPE,
    ("tetractl.commands", "track"): MICROSCOPE,
    ("tetractl.cameras", "apriltag"): MICROSCOPE,
    ("tetractl.cameras", "cells"): MICROSCOPE,
    ("tetractl.actuators", "field"): MICROSCOPE,
}
"""For a group of entry points and a name in it, the package that provides it."""


def not_installed(group: str, name: str) -> tuple[str, str] | None:
    """Return the sentence and the hint that say which package brings a name, None if none does."""
    package = BRINGS.get((group, name))
    if package is None:
        return None
    return f"needs {package}, which is not installed", f"pip install ./packages/{package}"

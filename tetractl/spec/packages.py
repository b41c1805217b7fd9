"""Packages in this repository that are installed apart, and what each brings: a name that is not
installed is answered by the command that installs it.
"""

from collections.abc import Sequence

MICROSCOPE = "tetractl-microscope"
EMULATOR = "tetractl-emulator"
TOIO = "tetractl-toio"
MOTION_CAPTURE = "tetractl-motioncapture"
PAPERS = "tetractl-papers"
IDENTIFY = "tetractl-identify"
BRINGS = {
    ("tetractl.plants", "emulated"): EMULATOR,
    ("tetractl.lab_commands", "emulate"): EMULATOR,
    ("tetractl.lab_commands", "rehearse"): EMULATOR,
    ("tetractl.lab_commands", "survey"): MICROSCOPE,
    ("tetractl.lab_commands", "markers"): MICROSCOPE,
    ("tetractl.commands", "reproduce"): PAPERS,
    ("tetractl.commands", "track"): MICROSCOPE,
    ("tetractl.commands", "identify"): IDENTIFY,
    ("tetractl.cameras", "apriltag"): MICROSCOPE,
    ("tetractl.cameras", "cells"): MICROSCOPE,
    ("tetractl.cameras", "toio"): TOIO,
    ("tetractl.cameras", "motioncapture"): MOTION_CAPTURE,
    ("tetractl.actuators", "field"): MICROSCOPE,
    ("tetractl.actuators", "toio"): TOIO,
    ("tetractl.trial_robots", "choose"): MICROSCOPE,
    ("tetractl.examples", "tetrahymena_dish"): MICROSCOPE,
    ("tetractl.examples", "tetrahymena_lab"): MICROSCOPE,
    ("tetractl.examples", "two_cells"): MICROSCOPE,
    ("tetractl.examples", "faults"): EMULATOR,
}
"""For a group of entry points and a name in it, the package that provides it; for an example, its
name or that of its folder."""


def missing(group: str, present: Sequence[str]) -> list[tuple[str, str]]:
    """Return the names of a group that are not present, each with the package that brings it."""
    return [
        (name, package)
        for (its_group, name), package in BRINGS.items()
        if its_group == group and name not in present
    ]


def not_installed(group: str, name: str) -> tuple[str, str] | None:
    """Return the sentence and the hint that say which package brings a name, None if none does."""
    package = BRINGS.get((group, name))
    if package is None:
        return None
    return f"needs {package}, which is not installed", f"pip install ./packages/{package}"

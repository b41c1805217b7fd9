"""The packages of this repository that are installed separately, and the names that they provide.

If a name belongs to a package that is not installed, the error shows how to install it.
"""

from collections.abc import Sequence

MICROSCOPE = "tetractl-microscope"
EMULATOR = "tetractl-emulator"
TOIO = "tetractl-toio"
MOTION_CAPTURE = "tetractl-motioncapture"
ROS2 = "tetractl-ros2"
PAPERS = "tetractl-papers"
IDENTIFY = "tetractl-identify"
LEARN = "tetractl-learn"
TESTING = "tetractl-testing"
PROVIDERS = {
    ("tetractl.plants", "emulated"): EMULATOR,
    ("tetractl.lab_commands", "emulate"): EMULATOR,
    ("tetractl.lab_commands", "rehearse"): EMULATOR,
    ("tetractl.lab_commands", "survey"): MICROSCOPE,
    ("tetractl.lab_commands", "markers"): MICROSCOPE,
    ("tetractl.commands", "reproduce"): PAPERS,
    ("tetractl.commands", "track"): MICROSCOPE,
    ("tetractl.commands", "identify"): IDENTIFY,
    ("tetractl.kind_checks", "kind"): TESTING,
    ("tetractl.controllers", "ensemble"): PAPERS,
    ("tetractl.controllers", "rrt"): PAPERS,
    ("tetractl.controllers", "policy"): LEARN,
    ("tetractl.figures", "swarm"): PAPERS,
    ("tetractl.commands", "rosbag-tables"): ROS2,
    ("tetractl.commands", "export-rosbag"): ROS2,
    ("tetractl.cameras", "apriltag"): MICROSCOPE,
    ("tetractl.cameras", "cells"): MICROSCOPE,
    ("tetractl.cameras", "toio"): TOIO,
    ("tetractl.cameras", "motioncapture"): MOTION_CAPTURE,
    ("tetractl.cameras", "ros2"): ROS2,
    ("tetractl.actuators", "field"): MICROSCOPE,
    ("tetractl.actuators", "toio"): TOIO,
    ("tetractl.actuators", "ros2"): ROS2,
    ("tetractl.trial_robots", "choose"): MICROSCOPE,
    ("tetractl.examples", "tetrahymena_dish"): MICROSCOPE,
    ("tetractl.examples", "tetrahymena_lab"): MICROSCOPE,
    ("tetractl.examples", "two_cells"): MICROSCOPE,
    ("tetractl.examples", "faults"): EMULATOR,
}
"""The package that provides each kind, command or example, by (group of entry points, name).

For an example, the name is the name of the example or its folder.
"""


def list_missing(group: str, present_names: Sequence[str]) -> list[tuple[str, str]]:
    """List the names of a group whose packages are not installed, as (name, package).

    Only the names of tetractl's own packages are known.

    Args:
        group: The group of entry points.
        present_names: The names that are installed.
    """
    return [
        (name, package)
        for (provided_group, name), package in PROVIDERS.items()
        if provided_group == group and name not in present_names
    ]


def explain_missing(group: str, name: str) -> tuple[str, str] | None:
    """Explain which package provides a name, and how to install it, as (problem, hint).

    None if no known package provides it. The caller has checked that the name is not installed.
    """
    package = PROVIDERS.get((group, name))
    if package is None:
        return None
    return f"needs {package}, which is not installed", f"pip install ./packages/{package}"

"""The rows of the fault table in virtual time: plant `emulated` plays every script."""

import pytest
from support.fault_checks import SCRIPTS, check
from support.lab_processes import camera_of
from support.scripts import load_script
from support.virtual_lab import play_faults

pytestmark = pytest.mark.slow


# this one is of the bytes of a server, which is not in memory
PATHS = [path for path in SCRIPTS if path.stem != "drips"]


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_fault(path, tmp_path):
    if camera_of(path) == "apriltag":
        pytest.importorskip("cv2")
    script = load_script(path, camera_of(path))
    check(script, play_faults(path, script, tmp_path))

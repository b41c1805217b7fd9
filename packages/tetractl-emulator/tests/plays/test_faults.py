"""Tests of every fault script in virtual time, on the plant `emulated`."""

import pytest
from testkit.emulator.fault_checks import SCRIPTS, check
from testkit.emulator.lab_processes import camera_of
from testkit.emulator.scripts import load_script
from testkit.emulator.virtual_lab import play_faults

pytestmark = pytest.mark.slow


# one of each device, and of what process, clock and disk do; CI plays the others, too
OFTEN = "bad_bytes clock_back ctrl_c disk_full emergency frames_doubled ghost jump"
OFTEN += " into_obstacle lifted lost_commands no_frames radio_unplugged robot_off swapped_wheels"
SHOWN_ELSEWHERE = (  # each as another row of the table, and of poses by test_ghosts.py
    *("ghost_at_rest", "ghost_drifting", "ghost_sideways", "ghost_slow", "ghost_turning"),
    *("cut_ended", "oversized"),  # as `cut`
    *("clock_jump_small", "lifted_60"),
)


def marks(name):
    """The tier of a row."""
    if name in OFTEN.split():
        return ()
    return (pytest.mark.long, pytest.mark.release) if name in SHOWN_ELSEWHERE else pytest.mark.long


PATHS = [
    pytest.param(path, id=path.stem, marks=marks(path.stem))
    for path in SCRIPTS
    if path.stem != "drips"  # of the bytes of a server, which is not in memory
]


@pytest.mark.parametrize("path", PATHS)
def test_fault(path, tmp_path):
    if camera_of(path) == "apriltag":
        pytest.importorskip("cv2")
    script = load_script(path, camera_of(path))
    check(script, play_faults(path, script, tmp_path))

"""Faults on real wires, of processes, ports and pictures: the emulator plays them on a run.

All others are played in virtual time; terminals, suspended runs and wanted ports are also of
test_lab_commands.py, silent sockets of test_udp_port.py. What the robots truly did is read from the
emulator's own record, not from the runner's log.
"""

import pytest
from testkit.emulator.fault_checks import SCRIPTS, check
from testkit.emulator.lab_processes import camera_of, play
from testkit.emulator.scripts import load_script

pytestmark = pytest.mark.system

LATE_S = 0.05  # half of the shortest tolerance: an emulator as late as that spoils the play
PROCESS = ("killed", "radio_unplugged")
AS_DRIPS = ("cut", "cut_ended", "oversized")  # pictures over HTTP
CHOSEN = [
    pytest.param(path, id=path.stem)
    for path in SCRIPTS
    if path.stem in PROCESS or (camera_of(path) == "apriltag" and path.stem not in AS_DRIPS)
]


@pytest.mark.parametrize("path", CHOSEN)
def test_fault(path, tmp_path):
    script = load_script(path, camera_of(path))
    played = play(path, script, tmp_path)
    try:
        check(script, played)
    except AssertionError:
        late_s = played.driven_late_s()
        if late_s < LATE_S:
            raise
        pytest.skip(f"the emulator was {late_s:.2f} s late")

"""Tests of faults of processes, ports and images during a run, over real connections.

All other faults are tested in virtual time. Faults of terminals, suspended runs and ports in use
are also tested in test_lab_commands.py, and silent sockets in test_udp_port.py. The tests read what
the robots truly did from the emulator's own record, not from the log of the run.
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

"""Faults on real wires, of processes, ports and pictures: the emulator plays them on a run.

All others are played in virtual time. What the robots truly did is read from the emulator's own
record, not from the runner's log.
"""

import pytest
from support.fault_checks import SCRIPTS, check
from support.lab_processes import camera_of, play
from support.scripts import load_script

pytestmark = pytest.mark.system

LATE_S = 0.05  # half of the shortest tolerance: an emulator as late as that spoils the play
AGAIN = ("no_server", "radio_unplugged", "stream_stops")  # in both, over sockets and ports
SIGNALS = ("asleep", "ctrl_c", "hung_up", "killed", "quit", "terminated")
PROCESS = ("disk_full", "second_run", *SIGNALS, *AGAIN)
SHOWN_ELSEWHERE = (  # in virtual time
    *("hung_up", "quit", "terminated"),  # and at `tetractl run` alone
    *("ctrl_c", "disk_full"),  # and on these wires a terminal that hangs; at `tetractl run` alone
    *("cut", "cut_ended", "oversized"),  # of pictures over HTTP, as `drips` is
    *("asleep", "second_run"),  # a run that is suspended and one whose port is wanted: `lab stop`
    *("no_server", "stream_stops"),  # of silent sockets: test_udp_port.py
)
CHOSEN = [
    pytest.param(
        path, id=path.stem, marks=pytest.mark.release if path.stem in SHOWN_ELSEWHERE else ()
    )
    for path in SCRIPTS
    if path.stem in PROCESS or camera_of(path) == "apriltag"
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

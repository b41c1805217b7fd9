"""Runs in an emulated lab in which nothing goes wrong, on real wires."""

import socket

import pytest
from support.good_runs import BEFORE_OBSTACLE, RUNS, check, script_of
from support.lab_processes import play
from support.scripts import load_script

pytestmark = pytest.mark.system


ROBOTS = "robots: [{name: green}, {name: blue}, {name: red}]"


def free_port():
    """A UDP port that no program uses now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind(("127.0.0.1", 0))
        return udp.getsockname()[1]


@pytest.mark.release  # lines in virtual time, in `plays`; the socket: test_udp_port.py
def test_robots_that_take_lines_over_udp(tmp_path):
    port = f"udp://127.0.0.1:{free_port()}"
    sets = (f"lab.actuator={{type: twist, port: '{port}', {ROBOTS}}}", BEFORE_OBSTACLE)
    script = tmp_path / "script.yaml"
    script.write_text("about: nothing goes wrong\n")
    played = play(script, load_script(script), tmp_path, sets=sets)
    assert played.of("ready")[0]["port"] == port
    check(sets, played)


def test_two_trials_over_multicast(tmp_path):
    name = "multicast, two trials"
    _, sets, replace_after = RUNS[name]
    options = () if replace_after is None else ("--replace-after", str(replace_after))
    script = script_of(name, tmp_path)
    check(sets, play(script, load_script(script), tmp_path, *options, sets=sets))

"""Tests of what a lab check prints, and of what scripts read from it."""

from dataclasses import replace

import pytest

from tetractl.core.protocols import RobotStatus
from tetractl.lab.preflight import Preflight, RobotFinding
from tetractl.view.terminal.findings import create_preflight_items, print_findings

pytestmark = pytest.mark.slow

READY = RobotFinding("green", 3.4, -0.02, "", "", RobotStatus(True, 7.41))
LOST = RobotFinding("red", None, None, "", "red is not tracked", RobotStatus(None))
FOUND = Preflight(
    (READY, LOST), (8.0, 12.5), 119.9, ("no radio",), ("dusty",), {"server": "Motive"}
)


def test_everything_found_is_printed_and_is_in_the_json(capsys):
    print_findings(FOUND, latency_stated=False)
    lines = capsys.readouterr().out.splitlines()
    for line in ("camera: 119.9 Hz", "server: Motive", "warning: dusty", "problem: no radio"):
        assert line in lines
    assert "age of frames on arrival: 8.0 ms, at most 12.5 ms" in lines
    assert lines[-1] == "not ready"
    document = create_preflight_items(FOUND)
    assert (document["ready"], document["robots"][0]["off_mm"]) == (False, 3.4)


@pytest.mark.parametrize(
    ("warnings", "verdict"),
    [
        ((), "ready"),
        (("tags were printed at 98 %",), "ready, with 1 warning"),
        (("dusty", "dark"), "ready, with 2 warnings"),
    ],
)
def test_the_last_line_says_of_how_much_is_warned(capsys, warnings, verdict):
    """Regression: of tags printed at 98 % the last line was "ready"."""
    print_findings(replace(FOUND, robots=(READY,), problems=(), warnings=warnings), False)
    assert capsys.readouterr().out.splitlines()[-1] == verdict


def test_an_age_of_frames_that_the_spec_states_is_not_printed_as_measured(capsys):
    """Regression: a latency of 10 ms that was 60 ms was printed as the age of frames."""
    print_findings(FOUND, latency_stated=True)
    age = "age of frames on arrival: 8.0 ms, at most 12.5 ms, if lab.camera.latency is right"
    assert age in capsys.readouterr().out.splitlines()

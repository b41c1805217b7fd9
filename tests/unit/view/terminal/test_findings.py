"""What a lab check prints, and what scripts read of it."""

import pytest

from tetractl.core.commands import RobotStatus
from tetractl.lab.preflight import Preflight, RobotFinding
from tetractl.view.terminal.findings import preflight_items, print_findings, robots_table

pytestmark = pytest.mark.slow

READY = RobotFinding("green", 3.4, -0.02, "", "", RobotStatus(True, 7.41))
LOST = RobotFinding("red", None, None, "", "red is not tracked", RobotStatus(None))
FOUND = Preflight(
    (READY, LOST), (8.0, 12.5), 119.9, ("no radio",), ("dusty",), {"server": "Motive"}
)


def test_a_robot_that_is_not_tracked_has_no_place():
    assert list(robots_table(FOUND).rows) == [
        ("green", "3", "-0.02", "7.41 V", "yes"),
        ("red", "not tracked", "-", "-", "n/a"),
    ]


def test_everything_found_is_printed_and_is_in_the_json(capsys):
    print_findings(FOUND)
    lines = capsys.readouterr().out.splitlines()
    for line in ("camera: 119.9 Hz", "server: Motive", "warning: dusty", "problem: no radio"):
        assert line in lines
    assert lines[-1] == "not ready"
    document = preflight_items(FOUND)
    assert (document["ready"], document["robots"][0]["off_mm"]) == (False, 3.4)

"""Tests of what the commands of `tetractl lab` print without a lab."""

import pytest

from tetractl.cli.lab import watched_by_operator
from tetractl.core.protocols import LabSupervision


@pytest.mark.parametrize("real_robots", [True, False])
def test_without_a_terminal_an_operator_of_real_robots_is_told_that_there_is_no_key(
    capsys, monkeypatch, real_robots
):
    """Regression: `lab calibrate` promises that space stops all robots, and said nothing of it if
    there was no terminal; `run` does."""
    monkeypatch.setattr("sys.stdin", None)
    with watched_by_operator(LabSupervision(), real_robots):
        pass
    no_key = "without a terminal, there is no key to stop the robots\n"
    assert capsys.readouterr().err == (no_key if real_robots else "")

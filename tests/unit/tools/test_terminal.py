"""Tests of what counts as a terminal: a pseudo-terminal does, except in a notebook cell."""

import os
import pty

import pytest

from tetractl.tools.terminal import is_terminal

IPYKERNEL = {"TERM": "xterm-color", "CLICOLOR_FORCE": "1", "GIT_PAGER": "cat"}
"""What every IPython kernel sets for its child processes (ipykernel 7.4, `init_environment`)."""


@pytest.fixture
def outside_a_notebook(monkeypatch):
    for name in ("JPY_PARENT_PID", *IPYKERNEL):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def stream(outside_a_notebook):
    """A stream that ends in a pseudo-terminal."""
    master, slave = pty.openpty()
    with os.fdopen(slave, "w") as opened:
        yield opened
    os.close(master)


def test_a_pseudo_terminal_is_a_terminal_and_a_file_or_a_closed_stdin_is_none(stream, tmp_path):
    assert is_terminal(stream)
    assert not is_terminal(None)
    with (tmp_path / "out.txt").open("w") as out:
        assert not is_terminal(out)


@pytest.mark.parametrize("settings", [{"JPY_PARENT_PID": "1234"}, IPYKERNEL])
def test_the_pseudo_terminal_of_a_notebook_s_cell_is_no_terminal(stream, monkeypatch, settings):
    for name, value in settings.items():
        monkeypatch.setenv(name, value)
    assert not is_terminal(stream)


@pytest.mark.parametrize("name", IPYKERNEL)
def test_one_setting_that_a_person_may_have_is_not_enough(stream, monkeypatch, name):
    monkeypatch.setenv(name, IPYKERNEL[name])
    assert is_terminal(stream)

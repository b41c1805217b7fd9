"""Tests that a plug-in is not blamed if the reader of its output ends early."""

import io

import pytest

from tetractl.tools.plugin_fault import create_plugin_error


class UnreadStream(io.StringIO):
    """A stream whose reader has ended."""

    def flush(self):
        raise BrokenPipeError


PACKAGES = {"plug-in": "1.0"}


def exit_of_rich():
    """Return what rich raises if nothing reads what it prints."""
    error = SystemExit(1)
    error.__context__ = BrokenPipeError()
    return error


def test_an_output_without_a_reader_blames_no_plugin(monkeypatch):
    """Regression: `track | true`: "plug-in command 'track' raised SystemExit: 1"."""
    assert create_plugin_error(exit_of_rich(), PACKAGES) is None
    monkeypatch.setattr("sys.stdout", UnreadStream())
    assert create_plugin_error(BrokenPipeError(), PACKAGES) is None


@pytest.mark.parametrize("error", [SystemExit(1), BrokenPipeError(), ValueError("x")])
def test_other_errors_name_the_plugins(error):
    """A pipe of a device that breaks is one: stdout has a reader."""
    assert create_plugin_error(error, PACKAGES).message.endswith(
        "; the spec uses these plug-ins: plug-in 1.0"
    )
    assert create_plugin_error(error, {}) is None

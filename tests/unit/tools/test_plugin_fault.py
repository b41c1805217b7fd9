"""Tests of which unexpected errors name the plug-ins of a trial, and which do not."""

import errno

import pytest

from tetractl.core.errors import AbortError, UsageError
from tetractl.tools.plugin_fault import (
    CALLS_MAX,
    PluginTrialError,
    create_plugin_error,
    name_plugins_in_errors,
)

PACKAGES = {"one": "1.0", "two": "2.1"}
FULL = OSError(errno.ENOSPC, "No space left")


def raised(error, packages=PACKAGES):
    """What comes out of a block in which an error is raised."""
    with pytest.raises(BaseException) as caught, name_plugins_in_errors(packages):
        raise error
    return caught.value


@pytest.mark.parametrize("error", [ValueError("x"), SystemExit(3), AssertionError(), OSError("y")])
def test_an_unexpected_error_names_the_plug_ins_and_keeps_its_cause(error):
    named = raised(error)
    assert isinstance(named, PluginTrialError)
    assert named.message.endswith("; the spec uses these plug-ins: one 1.0, two 2.1")
    assert named.message.startswith(type(error).__name__)
    assert named.__cause__ is error
    assert "kinds --check" in named.hint


@pytest.mark.parametrize(
    "error",
    [
        KeyboardInterrupt(),
        UsageError("wrong"),
        AbortError("a fault"),
        FULL,
        OSError(errno.EROFS, "read-only"),
        ModuleNotFoundError("x", name="termios"),
    ],
)
def test_other_errors_pass_unchanged(error):
    assert raised(error) is error


@pytest.mark.parametrize("error", [ValueError("x"), SystemExit(3)])
def test_an_error_of_our_own_passes_if_there_is_no_plug_in(error):
    assert raised(error, {}) is error


def test_another_module_that_is_missing_is_an_error_of_the_plug_in():
    missing = ModuleNotFoundError("x", name="cv2")
    assert isinstance(raised(missing), PluginTrialError)
    refused = OSError(errno.ECONNREFUSED, "refused")
    assert isinstance(raised(refused), PluginTrialError)


def deep(levels):
    if levels == 0:
        raise ValueError("x")
    deep(levels - 1)


def test_the_last_calls_are_kept():
    try:
        deep(50)
    except ValueError as error:
        named = create_plugin_error(error, PACKAGES)
    assert len(named.calls) == CALLS_MAX
    assert named.calls[-1].endswith('in deep: raise ValueError("x")')
    assert __file__ in named.calls[0]


def test_nothing_happens_without_an_error():
    with name_plugins_in_errors(PACKAGES):
        pass

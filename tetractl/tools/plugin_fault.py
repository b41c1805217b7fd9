"""Report an unexpected error in a trial with plug-ins as one line that names the plug-ins.

The program does not guess which plug-in is at fault. It keeps the calls that led to the error for
the log.
"""

import errno
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from traceback import extract_tb
from typing import TextIO

from tetractl.core.errors import TetractlError, describe_error

HINT = (
    "PYTHONDEVMODE=1 prints the traceback; tetractl kinds --check MODULE:NAME --spec SPEC "
    "tests a kind"
)
UNIX_MODULES = {"fcntl", "termios", "tty", "pty", "resource", "pwd", "grp"}
"""Modules of Python that Windows does not have; the lab needs them."""
COMPUTER_ERRNOS = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.ENFILE, errno.EMFILE}
"""Error numbers of `OSError` that come from the computer, such as a full disk."""
CALLS_MAX = 20
"""Maximum number of calls of a traceback that are kept."""


class PluginTrialError(TetractlError):
    """An unexpected error in a trial whose spec uses plug-ins.

    Attributes:
        calls: The calls that led to the error, one line each.
    """

    calls: tuple[str, ...] = ()


@contextmanager
def name_plugins_in_errors(packages: Mapping[str, str]) -> Iterator[None]:
    """Raise PluginTrialError for an unexpected error, such as `sys.exit`, inside the `with` block.

    Args:
        packages: Version of each package whose kinds the spec uses. If there is none, an
            unexpected error is our own and passes unchanged.
    """
    try:
        yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        plugin_error = create_plugin_error(error, packages)
        if plugin_error:
            raise plugin_error from error
        raise


def create_plugin_error(
    error: BaseException, packages: Mapping[str, str]
) -> PluginTrialError | None:
    """Create an error that names the plug-ins of a spec, for an unexpected error in a trial.

    Args:
        error: The error that was raised in a trial.
        packages: Version of each package whose kinds the spec uses.

    Returns:
        The new error. None if the spec uses no plug-in, if the error is a TetractlError, or if it
        comes from the computer, such as a full disk.
    """
    if not packages or isinstance(error, TetractlError) or _is_computer_error(error):
        return None
    plugin_list = ", ".join(f"{name} {version}" for name, version in packages.items())
    plugin_error = PluginTrialError(
        f"{describe_error(error)}; the spec uses these plug-ins: {plugin_list}", HINT
    )
    plugin_error.calls = tuple(
        f"{call.filename}:{call.lineno} in {call.name}: {call.line}"
        for call in extract_tb(error.__traceback__)[-CALLS_MAX:]
    )
    return plugin_error


def _is_computer_error(error: BaseException) -> bool:
    """Check whether an error comes from the computer or its system instead of from the code.

    Examples are a full disk, and output that nobody reads.
    """
    match error:
        case SystemExit(__context__=BrokenPipeError()):
            return True  # of rich, whose output has no reader any more
        case BrokenPipeError():
            return _has_no_reader(sys.stdout)
        case OSError(errno=number):
            return number in COMPUTER_ERRNOS
        case ModuleNotFoundError(name=name):
            return name in UNIX_MODULES
    return False


def _has_no_reader(stream: TextIO) -> bool:
    """Check whether nobody reads an output stream any more, by flushing it.

    Other errors of the stream are raised.
    """
    try:
        stream.flush()
    except BrokenPipeError:
        return True
    return False

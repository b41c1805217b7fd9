"""Report an unexpected error in a trial with plug-ins as one line that names the plug-ins.

The program does not guess which of them is at fault. It keeps the calls that led to the error for
the log.
"""

import errno
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from traceback import extract_tb
from typing import TextIO

from tetractl.core.errors import TetractlError, text_of

HINT = (
    "PYTHONDEVMODE=1 prints the traceback; tetractl kinds --check MODULE:NAME --spec SPEC "
    "tests a kind"
)
UNIX_MODULES = {"fcntl", "termios", "tty", "pty", "resource", "pwd", "grp"}
"""Modules of Python that Windows does not have; the lab needs them."""
COMPUTERS = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.ENFILE, errno.EMFILE}
"""Numbers of errors of the computer, such as a full disk."""
CALLS_MAX = 20
"""Maximum number of calls of a traceback that are kept."""


class PluginTrialError(TetractlError):
    """An unexpected error in a trial whose spec uses plug-ins.

    Attributes:
        calls: The calls that led to the error, one line each.
    """

    calls: tuple[str, ...] = ()


@contextmanager
def plugins_named(packages: Mapping[str, str]) -> Iterator[None]:
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
        named = naming_plugins(error, packages)
        if named:
            raise named from error
        raise


def naming_plugins(error: BaseException, packages: Mapping[str, str]) -> PluginTrialError | None:
    """Return an error that also names the plug-ins of a spec.

    Args:
        error: The error that was raised in a trial.
        packages: Version of each package whose kinds the spec uses.

    Returns:
        None if the spec uses no plug-in, for a TetractlError, and for an error of the computer,
        such as a full disk.
    """
    if not packages or isinstance(error, TetractlError) or _of_computer(error):
        return None
    used = ", ".join(f"{name} {version}" for name, version in packages.items())
    named = PluginTrialError(f"{text_of(error)}; the spec uses these plug-ins: {used}", HINT)
    named.calls = tuple(
        f"{call.filename}:{call.lineno} in {call.name}: {call.line}"
        for call in extract_tb(error.__traceback__)[-CALLS_MAX:]
    )
    return named


def _of_computer(error: BaseException) -> bool:
    """Check whether an error comes from the computer or its system instead of from the code.

    Examples are a full disk, and output that nobody reads.
    """
    match error:
        case SystemExit(__context__=BrokenPipeError()):
            return True  # of rich, whose output has no reader any more
        case BrokenPipeError():
            return _has_no_reader(sys.stdout)
        case OSError(errno=number):
            return number in COMPUTERS
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

"""Errors that a user can cause, their exit codes, and functions that make text safe to print.

Every message is one line, and can have a hint. The command line prints both without a traceback.
Any other exception is a bug in tetractl.
"""

import operator
import traceback
from enum import IntEnum
from itertools import pairwise
from pathlib import Path
from typing import Any


class Exit(IntEnum):
    """The exit codes of the command line, by which scripts see how a command ended."""

    DONE = 0
    FAILED = 1  # a trial was aborted, a check failed, or a log is damaged
    USAGE = 2  # the arguments or the spec are wrong
    LOSSY = 3  # a log was recovered, but not all of it; or it was not verified to its end
    INTERRUPTED = 130  # Ctrl-C or another signal, after stopping the robots and closing the log


class TetractlError(Exception):
    """An error that the user can fix, with a one-line message, a hint and an exit code.

    The command line prints the message and the hint. In Python, `str` returns the message, and the
    hint on a second line.

    Args:
        message: What is wrong, in one line.
        hint: What to do. None if there is no hint.
        in_python: The hint for users of the Python API, who have no options of the command line.
            None if it is the same as `hint`.
    """

    exit = Exit.FAILED

    def __init__(self, message: str, hint: str | None = None, in_python: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
        self.in_python = in_python or hint

    def __str__(self) -> str:
        return f"{self.message}\nhint: {self.in_python}" if self.in_python else self.message

    def _render_traceback_(self) -> list[str]:
        """Return the lines that IPython prints instead of a traceback.

        They contain the message, and the line of the user's code that called tetractl.
        """
        lines = [f"{type(self).__name__}: {self}"]
        package = str(Path(__file__).parents[1])
        for caller, called in pairwise(traceback.extract_tb(self.__traceback__)):
            if called.filename.startswith(package) and not caller.filename.startswith(package):
                lines.append(f"line {caller.lineno}: {caller.line}")
                break
        return [*lines, "(all of the traceback: import traceback; traceback.print_last())"]


class UsageError(TetractlError):
    """A mistake of the user: a wrong argument, file name or option."""

    exit = Exit.USAGE


def require_type(value: object, expected_type: Any, expectation: str) -> None:
    """Check that an argument of a call has the right type.

    Args:
        value: The argument.
        expected_type: The type that it must have, or a union of types.
        expectation: What is expected, as the start of the message.

    Raises:
        UsageError: If the value has another type.
    """
    if not isinstance(value, expected_type):
        raise UsageError(f"{expectation}, but the value given is of type {type(value).__name__}")


def require_whole_number(value: object, description: str) -> int:
    """Convert a value to a whole number from 0, such as the index of a trial.

    Args:
        value: The value.
        description: What the value is, as the start of the message.

    Raises:
        UsageError: If the value is not a whole number, or is negative.
    """
    try:
        number = operator.index(value)  # pyright: ignore[reportArgumentType] - the error says so
    except TypeError:
        number = -1
    if number < 0:
        raise UsageError(
            f"{description} must be a whole number of at least 0, but it is"
            f" {printable(str(value), 40)}"
        )
    return number


class SpecError(UsageError):
    """A spec has errors and cannot be run. The message has a `file:line:column` line per error."""


class LogError(TetractlError):
    """The log of a trial cannot be read or written."""


class ControlError(TetractlError):
    """The controller cannot continue, for instance because a cost is not finite."""


class AbortError(TetractlError):
    """The plant cannot continue because of a fault in the lab. The robots are stopped."""


class WrongValueError(TetractlError):
    """A plug-in returned a value that cannot be sent or logged.

    Args:
        who: The plug-in, as the message names it.
        what: The value, in words.
    """

    def __init__(self, who: str, what: str) -> None:
        super().__init__(f"{who} returned {what}")
        self.what = what


class WireError(ValueError):
    """Received bytes do not follow a wire format, or a value cannot be sent in the format.

    Receivers drop such bytes and count them. The parsers of `tetractl.lab` raise no other error.
    """


def printable(text: str, length: int | None = None) -> str:
    """Make a string safe for one line of a terminal, and cut it to `length` characters.

    A cut string ends with "...". If `length` is None, nothing is cut. Control characters (C0,
    escape and C1), changes of the writing direction, line separators and the bytes of a file name
    that is not UTF-8 are written as escapes.
    """
    printed = text if length is None else text[: length + 1]  # escaping never shortens a text
    if not printed.isprintable():
        printed = "".join(
            character if character.isprintable() else ascii(character)[1:-1]
            for character in printed
        )
    if length is not None and len(printed) > length:
        return printed[: length - 3] + "..."
    return printed


def format_unit(unit: str) -> str:
    """Return a spec's length unit as people write it: "um" becomes "µm"."""
    return unit.replace("um", "µm")


def describe_error(error: BaseException) -> str:
    """Describe an exception by its class and message, in one line of at most 300 characters.

    This also works if the creation of the exception's message raises an exception.
    """
    try:
        text = " ".join(str(error)[:2000].split())
    except Exception as fault:
        text = f"its text raises {type(fault).__name__}"
    return printable(f"{type(error).__name__}: {text}" if text else type(error).__name__, 300)

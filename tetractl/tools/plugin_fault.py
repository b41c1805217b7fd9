"""Says which plug-in raised an unexpected error, for the code that calls the kinds of a spec.

The plug-in is that of the innermost call whose code a package with kinds brought. An error of no
such code may come of a value that a plug-in returned: then all packages of the spec are named.
"""

import errno
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from traceback import extract_tb
from typing import TextIO

from tetractl.core.errors import TetractlError, WrongValueError, printable, text_of
from tetractl.core.registries import COMMANDS, LAB_COMMANDS, REGISTRIES

TRACEBACK_HINT = "PYTHONDEVMODE=1 prints its traceback"
CHECK = "tetractl kinds --check MODULE:NAME --spec SPEC tests a kind"
UNIX_MODULES = {"fcntl", "termios", "tty", "pty", "resource", "pwd", "grp"}
"""Modules of Python that Windows does not have; the lab needs them."""
COMPUTERS = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.ENFILE, errno.EMFILE}
"""Errors of the computer, such as a full disk."""
CALLS_MAX = 20
"""Most calls of a traceback that are kept."""


class FaultyPluginError(TetractlError):
    """A plug-in raised an exception; `calls` are the calls that led to it, one line each."""

    calls: tuple[str, ...] = ()


@contextmanager
def plugins_blamed(
    packages: Mapping[str, str] | None = None, spared: tuple[type[Exception], ...] = ()
) -> Iterator[None]:
    """Raise FaultyPluginError for an unexpected error of a plug-in, such as `sys.exit`, inside the
    `with` block, by `plugin_fault`; errors of the types `spared` pass."""
    try:
        yield
    except (KeyboardInterrupt, *spared):
        raise
    except BaseException as error:
        fault = plugin_fault(error, packages)
        if fault:
            raise fault from error
        raise


def plugin_fault(
    error: BaseException, packages: Mapping[str, str] | None = None
) -> FaultyPluginError | None:
    """Return an error that names the plug-in whose code raised `error`, called what raised it, or
    returned a wrong value; None if there is no such plug-in, for another TetractlError, and for an
    error of the computer, such as a full disk or a module that its system has not.

    If none is found, but `packages`, name and version, provide kinds, these are named.
    """
    if isinstance(error, WrongValueError):
        owner = _owner(_file(type(error.giver).__module__))
        if owner is not None:
            kinds = error.who if error.who in owner.kinds else owner.kinds  # the one of several
            text = f"plug-in {kinds} ({owner.package}) returned {error.what}"
            return FaultyPluginError(text, CHECK)
    elif isinstance(error, TetractlError) or _of_computer(error):
        return None
    what = text_of(error).removeprefix("WrongValueError: ")
    calls = extract_tb(error.__traceback__)
    for call in reversed(calls):
        owner = _owner(Path(call.filename).absolute())
        if owner is not None:
            place = f"{owner.package}, {call.filename}:{call.lineno}"
            text = f"plug-in {owner.kinds} ({place}) raised {printable(what, 300)}"
            fault = FaultyPluginError(text, TRACEBACK_HINT)
            fault.calls = tuple(
                f"{c.filename}:{c.lineno} in {c.name}: {c.line}" for c in calls[-CALLS_MAX:]
            )
            return fault
    if not packages:
        return None
    used = ", ".join(f"{name} {version}" for name, version in packages.items())
    return FaultyPluginError(f"{what}; the spec uses plug-ins of {used}", CHECK)


def _of_computer(error: BaseException) -> bool:
    """Return whether an error is of the computer or its system, in whichever code it occurs."""
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
    """Return whether what is written to a stream has no reader any more."""
    try:
        stream.flush()
    except BrokenPipeError:
        return True
    return False


@dataclass(frozen=True, slots=True)
class _Owner:
    """The plug-in that brought a file: its kinds, and its package with the version."""

    kinds: str
    package: str


def _owner(file: Path) -> _Owner | None:
    """Return the plug-in that defines a kind in a file or, failing that, the one in whose package
    the file is; None for a file of no plug-in."""
    kinds_of_file: dict[str, list[str]] = {}  # by their package
    kinds_around: dict[str, list[str]] = {}
    for registry in (*REGISTRIES, COMMANDS, LAB_COMMANDS):
        for kind in registry.kinds():
            if not kind.package:
                continue
            module = kind.code.partition(":")[0]
            top = module.partition(".")[0]
            package = f"{kind.package} {kind.version}"
            name = f"{registry.what} '{kind.name}'"
            if _file(module) == file:
                kinds_of_file.setdefault(package, []).append(name)
            elif top != module and _file(top).parent in file.parents:
                kinds_around.setdefault(package, []).append(name)
    for package, kinds in (kinds_of_file or kinds_around).items():
        return _Owner(" or ".join(kinds), package)
    return None


def _file(module: str) -> Path:
    """Return the file of an imported module, and one that does not exist for another module."""
    imported = sys.modules.get(module)
    return Path((imported and imported.__file__) or "/nowhere/nowhere")

"""Says which plug-in raised an unexpected error, for the code that calls the kinds of a spec."""

import errno
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from traceback import extract_tb
from typing import TextIO

from tetractl.core.errors import UNIX_MODULES, TetractlError, WrongValueError, printable, text_of
from tetractl.core.registries import COMMANDS, LAB_COMMANDS, REGISTRIES

TRACEBACK_HINT = "PYTHONDEVMODE=1 prints its traceback"
CHECK = "tetractl kinds --check MODULE:NAME --spec SPEC tests a kind"
COMPUTERS = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.ENFILE, errno.EMFILE}
"""Errors of the computer, such as a full disk."""
# reason, file and line in an error of numba's compiler
COMPILED = re.compile(r'(\S[^\n]*)\n\s*File "([^"]+)", line (\d+)')


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

    If none is found, but `packages`, name and version, provide kinds, these are named: one may have
    returned a value with which tetractl's code fails.
    """
    if isinstance(error, WrongValueError):
        owner = _owner(_file(type(error.giver).__module__))
        if owner:
            who = error.who if error.who in owner[0] else owner[0]  # the one of many that is named
            text = f"plug-in {who} ({owner[1]}) returned {error.what}"
            return FaultyPluginError(text, CHECK)
    elif isinstance(error, TetractlError) or _of_computer(error):
        return None
    calls = extract_tb(error.__traceback__)
    why = text_of(error).removeprefix("WrongValueError: ")
    places: list[tuple[str, str, object]]
    places = [(why, call.filename, call.lineno) for call in reversed(calls)]
    with suppress(Exception):  # it may have no text
        places += COMPILED.findall(str(error)[:20_000])
    for what, file, line in places:
        owner = _owner(Path(file).absolute())
        if owner:
            what = printable(what, 300)
            text = f"plug-in {owner[0]} ({owner[1]}, {file}:{line}) raised {what}"
            fault = FaultyPluginError(text, TRACEBACK_HINT)
            fault.calls = tuple(
                f"{call.filename}:{call.lineno} in {call.name}: {call.line}" for call in calls[-20:]
            )
            return fault
    used = ", ".join(f"{name} {version}" for name, version in (packages or {}).items())
    return FaultyPluginError(f"{why}; the spec uses plug-ins of {used}", CHECK) if used else None


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


def _owner(file: Path) -> tuple[str, str] | None:
    """Return the names of the kinds that a file defines, or of the kinds of its package if it
    defines none, and the package with its version; None for a file of no plug-in."""
    of_file = list[str]()
    of_package = list[str]()
    package = ""
    for registry in (*REGISTRIES, COMMANDS, LAB_COMMANDS):
        for kind in (kind for kind in registry.kinds() if kind.package):
            module = kind.code.partition(":")[0]
            top = module.partition(".")[0]
            is_own = _file(module) == file
            if is_own or (top != module and _file(top).parent in file.parents):
                (of_file if is_own else of_package).append(f"{registry.what} '{kind.name}'")
                package = f"{kind.package} {kind.version}"
    return (" or ".join(of_file or of_package), package) if package else None


def _file(module: str) -> Path:
    """Return the file of an imported module, and one that does not exist for another module."""
    imported = sys.modules.get(module)
    return Path((imported and imported.__file__) or "/nowhere/nowhere")

"""Says which plug-in raised an unexpected error, for the code that calls the kinds of a spec."""

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from traceback import extract_tb

from tetractl.core.errors import TetractlError, printable
from tetractl.core.registries import REGISTRIES

HINT = "PYTHONDEVMODE=1 prints its traceback"
# reason, file and line in an error of numba's compiler
COMPILED = re.compile(r'(\S[^\n]*)\n\s*File "([^"]+)", line (\d+)')


class FaultyPluginError(TetractlError):
    """A plug-in raised an exception; `calls` are the calls that led to it, one line each."""

    calls: tuple[str, ...] = ()


@contextmanager
def plugins_blamed() -> Iterator[None]:
    """Raise FaultyPluginError for an unexpected error of a plug-in inside the `with` block."""
    try:
        yield
    except TetractlError:
        raise
    except Exception as error:
        if fault := plugin_fault(error):
            raise fault from error
        raise


def plugin_fault(error: Exception) -> FaultyPluginError | None:
    """Return an error that names the plug-in whose code raised `error`, or called what raised it;
    None if there is no such plug-in.
    """
    calls, why = extract_tb(error.__traceback__), " ".join(str(error).split())
    places = [(why, call.filename, call.lineno) for call in reversed(calls)]
    for what, file, line in [*places, *COMPILED.findall(str(error))]:
        if owner := _owner(Path(file).absolute()):
            what = printable(f"{type(error).__name__}: {what}", 300)
            text = f"plug-in {owner[0]} ({owner[1]}, {file}:{line}) raised {what}"
            fault = FaultyPluginError(text, HINT)
            fault.calls = tuple(
                f"{call.filename}:{call.lineno} in {call.name}: {call.line}" for call in calls[-20:]
            )
            return fault
    return None


def _owner(file: Path) -> tuple[str, str] | None:
    """Return the names of the kinds that a file defines, or of the kinds of its package if it
    defines none, and the package with its version; None for a file of no plug-in."""
    own, near, package = list[str](), list[str](), ""
    for registry in REGISTRIES:
        for kind in (kind for kind in registry.kinds() if kind.package):
            module = kind.code.partition(":")[0]
            top = module.partition(".")[0]
            is_own = _file(module) == file
            if is_own or (top != module and _file(top).parent in file.parents):
                (own if is_own else near).append(f"{registry.what} '{kind.name}'")
                package = f"{kind.package} {kind.version}"
    return (" or ".join(own or near), package) if package else None


def _file(module: str) -> Path:
    """Return the file of an imported module, and one that does not exist for another module."""
    found = sys.modules.get(module)
    return Path((found and found.__file__) or "/nowhere/nowhere")

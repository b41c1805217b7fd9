"""What a command asks or says before it acts: warnings of a spec, and whether robots may move."""

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from tetractl.core.errors import UsageError

if TYPE_CHECKING:
    from tetractl.experiment.load import LoadedSpec
    from tetractl.run.plausibility.warnings import SpecWarning

Yes = Annotated[
    bool,
    typer.Option("--yes", help="Move robots without asking; needed where there is no terminal."),
]
Strict = Annotated[
    bool, typer.Option("--strict", help="Exit with code 2 where a spec has warnings.")
]


def warn(loaded: "LoadedSpec", sets: Sequence[str]) -> "tuple[SpecWarning, ...]":
    """Print what is doubtful in a spec that was loaded with `sets`, and return it."""
    from tetractl.run.plausibility.warnings import find_warnings

    found = find_warnings(loaded, sets)
    for warning in found:
        print(f"warning: {warning}", file=sys.stderr)
    return found


def refuse(found: "Sequence[SpecWarning]") -> None:
    """Raise UsageError where there are warnings, as `--strict` asks."""
    if found:
        count = "a warning" if len(found) == 1 else f"{len(found)} warnings"
        raise UsageError(f"the spec has {count}, and --strict allows none; nothing was run")


def need_consent(yes: bool) -> None:
    """Raise UsageError where robots would move, nobody can be asked, and `--yes` is not given."""
    if not yes and (sys.stdin is None or not sys.stdin.isatty()):
        raise UsageError(
            "robots would move, and without a terminal nobody can be asked",
            "add --yes to move them all the same",
        )

"""`tetractl kinds`: what can stand behind a `type` in a spec or a study."""

import json
import sys
from typing import Annotated

import typer

from tetractl.core.errors import Exit


def kinds(
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """List what a spec or a study can name as a `type`: optimisers, shapes, sweeps and so on.

    Each line holds the seam, the `type`, the package that provides it, and its code.
    Exits with 2 where an installed package is broken.

    Example: tetractl kinds
    """
    from tetractl.core.registry import PluginError
    from tetractl.experiment.kinds import SEAMS
    from tetractl.study.kinds import SWEEPS

    problems: dict[str, str] = {}
    rows = [(seam, kind) for seam in (*SEAMS, SWEEPS) for kind in seam.kinds()]
    for seam, kind in rows:
        try:
            seam.load(kind.name)
        except PluginError as error:
            problems[kind.code] = str(error)
    if as_json:
        listed = [
            {
                "seam": seam.what,
                "type": kind.name,
                "package": kind.package or None,
                "version": kind.version or None,
                "code": kind.code,
                "problem": problems.get(kind.code),
            }
            for seam, kind in rows
        ]
        print(json.dumps({"kinds": listed}, indent=2))
    else:
        for seam, kind in rows:
            package = f"{kind.package} {kind.version}" if kind.package else "built in"
            print(f"{seam.what:<11} {kind.name:<14} {package:<22} {kind.code}")
        for problem in problems.values():
            print(f"error: {problem}", file=sys.stderr)
    return Exit.USAGE if problems else Exit.DONE

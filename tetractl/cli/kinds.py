"""`tetractl kinds`: what can be named in a spec, a study, a table, a figure or an emulated lab."""

import json
import sys
from typing import Annotated

import typer

from tetractl.core.errors import Exit


def kinds(
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """List every kind there is: optimisers, shapes, cameras, sweeps, statistics, figures and so on.

    Each line holds the seam, the `type`, the package that provides it, and its code.
    Exits with 2 where an installed package is broken.

    Example: tetractl kinds
    """
    from tetractl.core.registry import PluginError
    from tetractl.emulate.sides import ACTUATORS, CAMERAS
    from tetractl.experiment.kinds import SEAMS
    from tetractl.results.kinds import STATISTICS
    from tetractl.study.kinds import SWEEPS
    from tetractl.view.figures.kinds import FIGURES

    problems: dict[str, str] = {}
    seams = (*SEAMS, SWEEPS, STATISTICS, FIGURES, CAMERAS, ACTUATORS)
    rows = [(seam, kind) for seam in seams for kind in seam.kinds()]
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
            print(f"{seam.what:<17} {kind.name:<19} {package:<22} {kind.code}")
        for problem in problems.values():
            print(f"error: {problem}", file=sys.stderr)
    return Exit.USAGE if problems else Exit.DONE

"""`tetractl analyze`: predicts how well robots can be steered together, without any trial."""

import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from tetractl.cli.options import Sets, load, progress
from tetractl.core.errors import Exit


def analyze(
    spec: Annotated[
        Path, typer.Argument(metavar="SPEC", help="Spec file of the experiment to analyse.")
    ],
    sets: Sets = None,
    plans: Annotated[
        int,
        typer.Option(
            min=1, max=1000, metavar="N", help="Number of plans to search for each result."
        ),
    ] = 5,
    form: Annotated[
        Literal["text", "json"], typer.Option("--format", help="Output format.")
    ] = "text",
    as_json: Annotated[bool, typer.Option("--json", help="The same as --format json.")] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o", "--out", metavar="FILE", help="File of the figure to draw: .png, .svg or .pdf."
        ),
    ] = None,
) -> int:
    """Predict how well the robots of a spec can be steered together; no trial is run.

    Searches good plans with the multistart optimiser. Along them, predicts the mean total error
    under the noise of the spec's simulated plant (errors of turning rate a and speed, random walk
    of the headings, measurement noise), the shortest plan that reaches the targets, the ellipse of
    each robot's end position, and the error of robots whose turning rates a differ more or less, or
    of fewer robots. If the turning rates a of two robots are too similar, searches for a better
    value of one of them.

    Example: tetractl analyze experiments/tetrahymena.yaml -o analysis.png
    """
    from tetractl.analysis.analysis_text import advice, tables
    from tetractl.analysis.analysis_text import as_json as items
    from tetractl.analysis.analyze import analyze as found_of
    from tetractl.core.errors import printable
    from tetractl.core.table.table_files import json_text
    from tetractl.core.table.terminal_table import print_tables

    if out:
        from tetractl.view.style import file_format

        file_format(out)  # checked before the search, which takes some seconds
    experiment = load(spec, sets or []).experiment
    with progress("Planning") as planned:
        found = found_of(experiment, plans, planned)
    if as_json or form == "json":
        print(json_text(items(found)))
    else:
        print_tables(tables(found))
        print(printable(advice(found)), flush=True)
    if out:
        from tetractl.view.figures.analysis import analysis_figure
        from tetractl.view.style import save

        save(analysis_figure(found), out)
        print(f"wrote {out}", file=sys.stderr)
    return Exit.DONE

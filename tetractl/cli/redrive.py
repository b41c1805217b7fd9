"""`tetractl redrive`: drive a plant again with recorded commands."""

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tetractl.cli.options import Log, Yes, open_trial
from tetractl.cli.trials import PlantChoice
from tetractl.core.errors import Exit

if TYPE_CHECKING:
    from tetractl.core.table.table import Table
    from tetractl.replay.redrive import Apart

ROWS = 12  # number of rows in the table of distances


def redrive(
    log: Log,
    plant: Annotated[
        PlantChoice,
        typer.Option(
            help="sim: drive a simulation. lab: drive the robots of the log's lab. emulated: "
            "emulate that lab in virtual time."
        ),
    ] = PlantChoice.SIM,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="DIR", help="Folder for the log of the new trial."),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            "--plot", metavar="FILE", help="File of a figure of both paths: .png, .svg or .pdf."
        ),
    ] = None,
    yes: Yes = False,
) -> int:
    """Drive a plant with the recorded commands of a log, open loop, in a new trial.

    Prints the distance between the recorded and the new path of each robot. In the lab the robots
    have to stand on their starts, and all checks of a run apply.

    Example: tetractl redrive trial-000.mcap --plant sim --plot apart.svg
    """
    from tetractl.cli.rerun import recorded
    from tetractl.cli.trials import drive
    from tetractl.core.table.terminal_table import print_tables
    from tetractl.log.read.find import find_log
    from tetractl.replay.redrive import paths_apart, recorded_directions, sequence_spec
    from tetractl.run.store import default_folder
    from tetractl.view.style import file_format

    if picture is not None:
        file_format(picture)
    log = find_log(log)
    was = open_trial(log)
    spec, trial = recorded(log, plant.value)
    spec = sequence_spec(spec, *recorded_directions(was))
    folder = out or default_folder(f"{spec.experiment.name}-again", datetime.now(UTC))
    path = drive(spec, folder, trial, yes)
    again = open_trial(path)
    apart = paths_apart(was, again)
    print(f"{log} ({was.origin.value}) and {path} ({again.origin.value}), open loop")
    print_tables([_table(apart)])
    print(f"log in {path}")
    if picture is not None:
        from tetractl.view.figures.trajectory import redriven_figure
        from tetractl.view.style import save

        save(redriven_figure(was, again, apart), picture)
        print(picture)
    return Exit.FAILED if was.damage else Exit.DONE


def _table(apart: "Apart") -> "Table":
    """Return a table of distances between two paths: at a few times, the largest, and the last."""
    import numpy as np

    from tetractl.core.table.table import Column, Table, fixed

    last = max(len(apart.time_s) - 1, 0)
    rows = np.unique(np.linspace(0, last, ROWS).astype(int))[: len(apart.time_s)]
    known = np.nan_to_num(apart.distance, nan=-1.0).max(axis=0, initial=-1.0)
    most = np.where(known >= 0, known, np.nan)
    times = [*(f"{apart.time_s[i]:.2f}" for i in rows), "at most", "at last"]
    distances = np.vstack([apart.distance[rows], most, apart.final])
    columns = (
        Column(name, values, apart.unit, fixed(2))
        for name, values in zip(apart.names, distances.T, strict=True)
    )
    return Table(
        "The same directions at the same times: distance between each robot's two paths",
        (Column("time", times, "s"), *columns),
    )

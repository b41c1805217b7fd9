"""`tetractl rerun`: run the trial of a log again, and compare the two logs."""

from typing import Annotated

import typer

from tetractl.cli.options import Log, Yes
from tetractl.cli.serving import Port, Serve, wanted_port
from tetractl.cli.trials import (
    DryRun,
    Json,
    Out,
    PlantChoice,
    Quiet,
    Unattended,
    run_command,
)
from tetractl.core.errors import Exit


def rerun(
    log: Log,
    plant: Annotated[
        PlantChoice,
        typer.Option(help="sim: simulate. lab: drive the robots of the log's lab."),
    ] = PlantChoice.SIM,
    yes: Yes = False,
    unattended: Unattended = False,
    out: Out = None,
    dry_run: DryRun = False,
    quiet: Quiet = False,
    serve: Serve = False,
    port: Port = None,
    json: Json = False,
) -> int:
    """Run the trial of a log again, with the spec and seed in the log, and compare the two logs.

    A simulated trial repeats exactly: the exit code is 1 if the two logs differ in content. The
    trial of a log from a lab is simulated too; robots move only with --plant lab.

    Example: tetractl rerun logs/demo/trial-003.mcap
    """
    from tetractl.log.read.find import find_log
    from tetractl.replay.rerun import compare, recorded
    from tetractl.run.task import log_path

    log = find_log(log)
    loaded, trial = recorded(log, plant.value)
    code, folder = run_command(
        loaded,
        out,
        trial,
        dry_run=dry_run,
        quiet=quiet,
        yes=yes,
        port=wanted_port(serve, port),
        json=json,
        unattended=unattended,
    )
    if code == Exit.DONE and not dry_run:
        return compare(log, log_path(folder, trial))
    return code

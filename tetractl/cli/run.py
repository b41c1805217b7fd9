"""`tetractl run`: run the trials of an experiment."""

from typing import Annotated

import typer

from tetractl.cli.options import Sets, Spec, Strict, Yes, refuse, warn
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
from tetractl.core.errors import UsageError


def run(
    spec: Spec,
    trials: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Number of trials.  \\[spec: trials.count]"),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, metavar="S", help="Seed of all random numbers.  \\[spec: trials.seed]"),
    ] = None,
    sets: Sets = None,
    plant: Annotated[
        PlantChoice | None,
        typer.Option(
            help="sim: simulate. lab: drive the robots of the spec's lab. emulated: emulate that "
            "lab in virtual time.  \\[spec: plant.type]"
        ),
    ] = None,
    yes: Yes = False,
    unattended: Unattended = False,
    out: Out = None,
    jobs: Annotated[
        int,
        typer.Option(
            min=1, metavar="N", help="Number of trials run at a time, each in its own process."
        ),
    ] = 1,
    resume: Annotated[
        bool, typer.Option("--resume", help="Run only the trials without a complete log in DIR.")
    ] = False,
    dry_run: DryRun = False,
    strict: Strict = False,
    quiet: Quiet = False,
    serve: Serve = False,
    port: Port = None,
    json: Json = False,
) -> int:
    """Run the trials of an experiment, log each to DIR/trial-000.mcap ..., print the statistics.

    In the lab a person at the terminal is shown where robots must stand and starts the robots by
    Enter; without a terminal, give --yes.

    With --serve a simulated trial takes as long as a real one.

    Ctrl-C finishes the step, stops the robots and closes the log; a second Ctrl-C does not wait for
    the step.

    Example: tetractl run experiments/three_m3pi.yaml --trials 5 --set plant.dead_time=0.1
    """
    from tetractl.cli.options import load
    from tetractl.experiment.plants import on_plant

    if resume and out is None:
        raise UsageError("--resume needs --out", "name the folder of the batch to continue")
    settings = list(sets or [])
    settings += [] if trials is None else [f"trials.count={trials}"]
    settings += [] if seed is None else [f"trials.seed={seed}"]
    loaded = load(spec, settings)
    cautions = warn(loaded, settings)
    if strict:
        refuse(cautions)
    if serve and jobs > 1:
        raise UsageError("--serve shows one trial at a time", "leave out --jobs")
    code, _ = run_command(
        on_plant(loaded, plant.value if plant else None),
        out,
        jobs=jobs,
        resume=resume,
        dry_run=dry_run,
        quiet=quiet,
        yes=yes,
        port=wanted_port(serve, port),
        json=json,
        unattended=unattended,
    )
    return code

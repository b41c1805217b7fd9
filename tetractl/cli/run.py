"""The command `tetractl run`, which runs the trials of an experiment, simulated or in a lab."""

from typing import Annotated

from tetractl.cli import options
from tetractl.cli.trials import RunOptions, choose_port, load_to_run, run_command
from tetractl.core.errors import UsageError


def run(
    spec: options.Spec,
    trials: Annotated[
        int | None, options.option("N", "Number of trials. [spec: trials.count]", min=1)
    ] = None,
    seed: options.Seed = None,
    sets: options.Sets = None,
    plant: Annotated[
        str | None,
        options.plant_option(
            "sim: simulate. lab: drive the robots of the spec's lab. emulated: emulate this "
            "lab in virtual time. [spec: plant.type]"
        ),
    ] = None,
    yes: options.Yes = False,
    unattended: options.Unattended = False,
    out: options.LogFolder = None,
    jobs: Annotated[
        int,
        options.option(
            "N", "Number of trials to run at the same time, each in its own process.", min=1
        ),
    ] = 1,
    resume: Annotated[
        bool,
        options.switch("Run only the trials that have no complete log in DIR yet.", "--resume"),
    ] = False,
    keep_going: Annotated[
        bool | None,
        options.switch(
            "Go on with the next trial after an abort, unless somebody has to touch a robot or a "
            "device first. [emulated: yes; otherwise: no]",
        ),
    ] = None,
    rate: Annotated[
        float | None,
        options.option("R", "Show simulated trials at R times real speed.", min=0.1, max=100),
    ] = None,
    dry_run: options.DryRun = False,
    strict: options.Strict = False,
    quiet: options.Quiet = False,
    serve: options.Serve = False,
    port: options.ServePort = None,
    json: options.StatsJson = False,
) -> int:
    """Run the trials of an experiment, log each to DIR/trial-000.mcap ..., print the statistics.

    In the lab, the command shows where the robots must stand, and a person at the terminal starts
    the robots with Enter. Without a terminal, give --yes.

    With --keep-going, a batch goes on after an abort if the camera showed that the robots stand
    still. In the lab, every trial waits until the robots are back at their starts. The batch still
    ends after an emergency stop, after the failure of a device, if a robot may still move, or if
    the next trial cannot start. The exit code of a batch with an aborted
    trial is 1.

    With --rate 1, or with --serve, a simulated trial takes as long as a real one.

    Ctrl-C finishes the control step, stops the robots and closes the log. A second Ctrl-C does not
    wait for the step.

    Example: tetractl run experiments/three_m3pi.yaml --trials 5 --set plant.dead_time=0.1
    """
    from tetractl.spec.yaml.settings import FieldValue

    if resume and out is None:
        raise UsageError(
            "--resume needs --out", "name the folder of the batch to continue with --out"
        )
    if serve and jobs > 1:
        raise UsageError("--serve shows only one trial at a time", "leave out --jobs")
    if rate is not None and (serve or jobs > 1):
        raise UsageError(
            "--rate shows only one trial at a time",
            "leave out --rate, or leave out --serve and --jobs",
        )
    run_options = RunOptions(
        out=out,
        jobs=jobs,
        resume=resume,
        keep_going=keep_going,
        dry_run=dry_run,
        quiet=quiet,
        yes=yes,
        port=choose_port(serve, port),
        json=json,
        unattended=unattended,
        rate=rate,
    )
    of_spec = [
        FieldValue("trials.count", trials, "--trials"),
        FieldValue("trials.seed", seed, "--seed"),
    ]
    loaded = load_to_run(spec, sets or [], plant, of_spec, strict)
    code, _ = run_command(loaded, run_options)
    return code

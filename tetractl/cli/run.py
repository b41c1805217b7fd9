"""`tetractl run`: run the trials of an experiment."""

from pathlib import Path
from typing import Annotated

from tetractl.cli import ui
from tetractl.cli.serve import TCP, wanted_port
from tetractl.cli.trials import RunOptions, run_command
from tetractl.core.errors import UsageError


def run(
    spec: ui.Spec,
    trials: Annotated[int | None, ui.ValueRange(1)] = None,
    seed: Annotated[int | None, ui.ValueRange(0)] = None,
    sets: ui.Sets = None,
    plant: str | None = None,
    yes: ui.Yes = False,
    unattended: bool = False,
    out: Path | None = None,
    jobs: Annotated[int, ui.ValueRange(1)] = 1,
    resume: bool = False,
    dry_run: bool = False,
    strict: ui.Strict = False,
    quiet: Annotated[bool, "--quiet", "-q"] = False,
    serve: bool = False,
    port: Annotated[int | None, TCP] = None,
    json: bool = False,
) -> int:
    """Run the trials of an experiment, log each to DIR/trial-000.mcap ..., print the statistics.

    In the lab a person at the terminal is shown where robots must stand and starts the robots by
    Enter; without a terminal, give --yes.

    With --serve a simulated trial takes as long as a real one.

    Ctrl-C finishes the step, stops the robots and closes the log; a second Ctrl-C does not wait for
    the step.

    Example: tetractl run experiments/three_m3pi.yaml --trials 5 --set plant.dead_time=0.1

    Options:
      trials N: Number of trials.  [spec: trials.count]
      seed S: Seed of all random numbers.  [spec: trials.seed]
      plant sim|lab|emulated: sim: simulate. lab: drive the robots of the spec's lab. emulated:
        emulate that lab in virtual time.  [spec: plant.type]
      unattended: Lab only, with --yes: go on if the terminal closes or no process reads the output
        any more, which otherwise stops the robots.
      out DIR: Folder for the logs.  [logs/<spec name>-<UTC time>]
      jobs N: Number of trials run at a time, each in its own process.
      resume: Run only the trials without a complete log in DIR.
      dry_run: Run nothing: print the spec, its limits and what would be run.
      quiet: Show neither a live view nor progress.
      serve: Print a link that shows the trial in Foxglove or Lichtblick as it runs.
      port N: With --serve: TCP port of the server; 0 for any free port.  [8765]
      json: Print the statistics as JSON, like `stats --format json`.
    """
    from tetractl.experiment.plants import on_plant

    if resume and out is None:
        raise UsageError("--resume needs --out", "name the folder of the batch to continue")
    settings = list(sets or [])
    settings += [] if trials is None else [f"trials.count={trials}"]
    settings += [] if seed is None else [f"trials.seed={seed}"]
    loaded = ui.load(spec, settings)
    ui.warn(loaded, settings, strict)
    if serve and jobs > 1:
        raise UsageError("--serve shows one trial at a time", "leave out --jobs")
    served = wanted_port(serve, port)
    options = RunOptions(out, jobs, resume, dry_run, quiet, yes, served, json, unattended)
    return run_command(on_plant(loaded, plant), options)[0]

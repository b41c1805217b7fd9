"""`tetractl rerun`: run the trial of a log again, and compare the two logs."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
from tetractl.core.errors import Exit, printable

if TYPE_CHECKING:
    from tetractl.experiment.load import LoadedSpec
    from tetractl.experiment.plants import PlantKind


def rerun(
    log: Log,
    plant: Annotated[
        PlantChoice,
        typer.Option(
            help="sim: simulate. lab: drive the robots of the log's lab. emulated: emulate that "
            "lab in virtual time."
        ),
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

    A trial in virtual time repeats exactly on its plant: the exit code is 1 if the two logs differ
    in content. The trial of a log from a lab is simulated too; robots move only with --plant lab.

    Example: tetractl rerun logs/demo/trial-003.mcap
    """
    from tetractl.log.read.find import find_log
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


def recorded(log: Path, plant: "PlantKind") -> "tuple[LoadedSpec, int]":
    """Return the spec of a log, changed to the given plant, and the trial's index in its batch.

    No calibration file is read: the spec in a log of the lab has the calibration's values.
    """
    from dataclasses import replace

    from tetractl.experiment.lab_section import LabSection
    from tetractl.experiment.load import LoadedSpec
    from tetractl.experiment.plants import lab_as, on_plant
    from tetractl.log.read.reader import read_trial

    trial = read_trial(log)
    start = trial.start
    spec = LoadedSpec(trial.experiment, start.spec_text, start.spec_name, attached=start.attached)
    lab = trial.experiment.plant
    if plant == "sim" or not isinstance(lab, LabSection):
        return on_plant(spec, plant), start.trial
    changed: dict[str, Any] = {"plant": lab_as(plant, lab)}
    if (choice := trial.experiment.chosen) is not None:  # no cell is where the log's trial began
        changed["chosen"] = choice.model_copy(update={"found": False})
    return replace(spec, experiment=trial.experiment.model_copy(update=changed)), start.trial


def compare(log: Path, again: Path) -> int:
    """Print whether two logs of a trial have the same content; return FAILED if they differ."""
    from tetractl.log.read.reader import content_digest, read_result, read_trial
    from tetractl.replay.difference import trial_difference
    from tetractl.replay.verify import host_differences

    first, second = read_result(log), read_result(again)
    plants = [one.experiment.plant for one in (first, second)]
    if plants[0].type != plants[1].type or plants[0].real_time:
        names = {"sim": "simulated", "lab": "of the lab"}
        kinds = (names.get(plant.type, plant.type) for plant in plants)
        text = "the log is {}, the new one {}: the two are not compared"
        print(text.format(*kinds), file=sys.stderr)
        return Exit.DONE
    one, two = (content_digest(path) for path in (log, again))
    if one == two:
        print(f"the content digests agree: {one}", file=sys.stderr)
        return Exit.DONE
    print(f"the content digests differ: {one} in {log}, {two} in {again}", file=sys.stderr)
    was, is_now = read_trial(log), read_trial(again)
    if difference := trial_difference(is_now, was):
        print(printable(f"  {difference}"), file=sys.stderr)
    if first.recovered or not first.outcome.complete:
        print(f"  {log} is damaged, or its trial did not run to its end", file=sys.stderr)
    if was.start.resolved != is_now.start.resolved:
        print("  the log's spec lacks fields of this tetractl", file=sys.stderr)
    for line in host_differences(was):
        print(printable(f"  {line}"), file=sys.stderr)
    return Exit.FAILED

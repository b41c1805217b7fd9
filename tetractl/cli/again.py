"""`tetractl rerun`, `redrive` and `what-if`: a recorded trial again; the same spec and seed, the
same commands, or another controller.
"""

from collections.abc import Iterator
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tetractl.cli import ui
from tetractl.cli.serve import TCP, wanted_port
from tetractl.cli.trials import RunOptions, drive, run_command
from tetractl.core.errors import Exit, printable
from tetractl.core.table.table import Column, Table, fixed
from tetractl.core.table.table_files import json_text
from tetractl.core.table.terminal_table import print_tables
from tetractl.log.read.find import find_log, find_logs

if TYPE_CHECKING:
    from tetractl.experiment.load import LoadedSpec
    from tetractl.log.read.trial_log import TrialLog
    from tetractl.replay.open_loop import Apart, WhatIf

PREDICTION = (
    "a prediction on the recorded observations, not closed loop: the robots followed the recorded "
    "directions"
)


def rerun(
    log: ui.Log,
    plant: ui.PlantChoice = "sim",
    yes: ui.Yes = False,
    unattended: bool = False,
    out: Path | None = None,
    dry_run: bool = False,
    quiet: Annotated[bool, "--quiet", "-q"] = False,
    serve: bool = False,
    port: Annotated[int | None, TCP] = None,
    json: bool = False,
) -> int:
    """Run the trial of a log again, with the spec and seed in the log, and compare the two logs.

    A trial in virtual time repeats exactly on its plant: the exit code is 1 if the two logs differ
    in content. The trial of a log from a lab is simulated too; robots move only with --plant lab.

    Example: tetractl rerun logs/demo/trial-003.mcap

    Options:
      plant sim|lab|emulated: sim: simulate. lab: drive the robots of the log's lab. emulated:
        emulate that lab in virtual time.
      unattended: Lab only, with --yes: go on if the terminal closes or no process reads the output
        any more, which otherwise stops the robots.
      out DIR: Folder for the logs.  [logs/<spec name>-<UTC time>]
      dry_run: Run nothing: print the spec, its limits and what would be run.
      quiet: Show neither a live view nor progress.
      serve: Print a link that shows the trial in Foxglove or Lichtblick as it runs.
      port N: With --serve: TCP port of the server; 0 for any free port.  [8765]
      json: Print the statistics as JSON, like `stats --format json`.
    """
    from tetractl.log.read.reader import read_trial
    from tetractl.run.task import log_path

    log = find_log(log)
    trial = read_trial(log)
    options = RunOptions(
        out, 1, False, dry_run, quiet, yes, wanted_port(serve, port), json, unattended
    )
    number = trial.start.trial
    code, folder = run_command(_recorded(trial, plant), options, number)
    if code == Exit.DONE and not dry_run:
        return _compare(log, log_path(folder, number))
    return code


def _recorded(trial: "TrialLog", plant: ui.PlantChoice) -> "LoadedSpec":
    """Return the spec of a log, changed to the given plant.

    No calibration file is read: the spec in a log of the lab has the calibration's values.
    """
    from tetractl.experiment.lab_section import LabSection
    from tetractl.experiment.load import LoadedSpec
    from tetractl.experiment.plants import lab_as, on_plant

    start, lab = trial.start, trial.experiment.plant
    spec = LoadedSpec(trial.experiment, start.spec_text, start.spec_name, attached=start.attached)
    if plant == "sim" or not isinstance(lab, LabSection):
        return on_plant(spec, plant)
    changed: dict[str, Any] = {"plant": lab_as(plant, lab)}
    if (choice := trial.experiment.chosen) is not None:  # no cell is where the log's trial began
        changed["chosen"] = choice.model_copy(update={"found": False})
    return replace(spec, experiment=trial.experiment.model_copy(update=changed))


def _compare(log: Path, again: Path) -> int:
    """Print whether two logs of a trial have the same content; return FAILED if they differ."""
    from tetractl.log.format.channels import RESOLVED_SPEC
    from tetractl.log.read.reader import result_of, trial_of
    from tetractl.log.read.salvage import scan
    from tetractl.replay.comparison import log_difference
    from tetractl.replay.verify import host_differences

    was, is_now = scan(log), scan(again)
    first, second = result_of(was), result_of(is_now)
    plants = [one.experiment.plant for one in (first, second)]
    if plants[0].type != plants[1].type or plants[0].real_time:
        names = {"sim": "simulated", "lab": "of the lab"}
        one, two = (names.get(plant.type, plant.type) for plant in plants)
        ui.tell(f"the log is {one}, the new one {two}: the two are not compared")
        return Exit.DONE
    one, two = was.digests.content, is_now.digests.content
    if one == two:
        ui.tell(f"the content digests agree: {one}")
        return Exit.DONE
    ui.tell(f"the content digests differ: {one} in {log}, {two} in {again}")
    if difference := log_difference(is_now, was):
        ui.tell(f"  {difference}")
    if first.recovered or not first.outcome.complete:
        ui.tell(f"  {log} is damaged, or its trial did not run to its end")
    if was.text(RESOLVED_SPEC) != is_now.text(RESOLVED_SPEC):
        ui.tell("  the log's spec lacks fields of this tetractl")
    ui.tell(*(f"  {line}" for line in host_differences(trial_of(was))))
    return Exit.FAILED


def redrive(
    log: ui.Log,
    plant: ui.PlantChoice = "sim",
    out: Path | None = None,
    picture: Annotated[Path | None, "--plot"] = None,
    yes: ui.Yes = False,
) -> int:
    """Drive a plant with the recorded commands of a log, open loop, in a new trial.

    Prints the distance between the recorded and the new path of each robot. In the lab the robots
    have to stand on their starts, and all checks of a run apply.

    Example: tetractl redrive trial-000.mcap --plant sim --plot apart.svg

    Options:
      plant sim|lab|emulated: sim: drive a simulation. lab: drive the robots of the log's lab.
        emulated: emulate that lab in virtual time.
      out DIR: Folder for the log of the new trial.
      picture FILE: File of a figure of both paths: .png, .svg or .pdf.
    """
    from tetractl.replay.open_loop import paths_apart, recorded_directions, sequence_spec
    from tetractl.run.store import default_folder
    from tetractl.view.figures.trajectory import redriven_figure
    from tetractl.view.style import file_format, save

    if picture is not None:
        file_format(picture)
    log = find_log(log)
    was = ui.open_trial(log)
    spec = sequence_spec(_recorded(was, plant), *recorded_directions(was))
    folder = out or default_folder(f"{spec.experiment.name}-again", datetime.now(UTC))
    path = drive(spec, folder, was.start.trial, yes)
    again = ui.open_trial(path)
    apart = paths_apart(was, again)
    print(f"{log} ({was.origin.value}) and {path} ({again.origin.value}), open loop")
    print_tables([_distances(apart)])
    print(f"log in {path}")
    if picture is not None:
        save(redriven_figure(was, again, apart), picture)
        print(picture)
    return Exit.FAILED if was.damage else Exit.DONE


def _distances(apart: "Apart") -> "Table":
    """Return a table of distances between two paths: at a few times, the largest, and the last."""
    import numpy as np

    last = max(len(apart.time_s) - 1, 0)
    rows = np.unique(np.linspace(0, last, 12).astype(int))[: len(apart.time_s)]
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


def what_if(
    logs: ui.Logs,
    sets: Annotated[list[str], "--set"],
    as_json: ui.AsJson = False,
) -> int:
    """Print what another controller would have decided on the recorded observations.

    For each control step it prints the recorded and the other direction, their difference, and the
    largest distance between a robot's ends as predicted by the two plans. This is an open-loop
    prediction: the robots do not follow the other controller.

    Example: tetractl what-if trial-000.mcap --set controller.horizon_max=20

    Options:
      sets PATH=VALUE: Replace a value of the controller, as field=value; may be repeated.
    """
    from tetractl.log.read.reader import read_trial
    from tetractl.replay import open_loop

    done: list[dict[str, Any]] = []
    for path in find_logs(logs):
        log = read_trial(path)
        other = open_loop.other_experiment(log, sets)
        other.controller.warm_up(other.setup)
        found = open_loop.what_if(log, other)
        if as_json:
            items = {**asdict(found), "changed": found.changed}
            done.append({"path": str(path), "origin": log.origin.value, **items})
            continue
        print(printable(f"{path} ({log.origin.value}), with {', '.join(sets)}:"))
        print_tables([_decisions(found)])
    if as_json:
        print(json_text({"prediction": PREDICTION, "set": list(sets), "logs": done}))
    return Exit.DONE


def _decisions(found: "WhatIf") -> "Table":
    """Return a table of the predicted decisions next to the recorded ones."""
    unit, steps, three = found.unit, found.steps, fixed(3)
    columns = (
        Column("k", [step.k for step in steps]),
        Column("time", [step.time_s for step in steps], "s", fixed(2)),
        Column("sent", [step.recorded for step in steps], "rad", fixed(4)),
        Column("other", [step.other for step in steps], "rad", fixed(4)),
        Column("change", [step.difference for step in steps], "rad", "{:+.4f}".format),
        Column("signals", [f"{step.recorded_length}/{step.other_length}" for step in steps]),
        Column("predicted error", [step.recorded_error for step in steps], unit, three),
        Column("with other", [step.other_error for step in steps], unit, three),
        Column("ends differ", [step.apart.max() for step in steps], unit, three),
    )
    return Table(PREDICTION, columns, "\n".join(_summary(found)))


def _summary(found: "WhatIf") -> Iterator[str]:
    import numpy as np

    if found.ended:
        yield found.ended
    if not found.steps:
        return
    unit = found.unit
    apart = np.array([step.apart for step in found.steps])
    turned = np.abs([step.difference for step in found.steps])
    yield (
        f"{found.changed} of {len(found.steps)} steps would have sent another direction; over all "
        f"steps, it differs by {turned.mean():.4f} rad on average and {turned.max():.4f} at most"
    )
    yield (
        f"the predicted ends of a robot differ by {apart.mean():.3f} {unit} on average and "
        f"{apart.max():.3f} at most"
    )

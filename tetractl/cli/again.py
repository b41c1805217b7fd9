"""`tetractl rerun`: a recorded trial again, with the spec and seed in its log, or with values of
that spec replaced.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tetractl.cli import options, ui
from tetractl.cli.trials import RunOptions, run_command, wanted_port
from tetractl.core.errors import Exit
from tetractl.log.read.find import find_log

if TYPE_CHECKING:
    from tetractl.experiment.load import LoadedSpec
    from tetractl.log.read.trial_log import TrialLog


def rerun(
    log: options.Log,
    sets: options.Sets = None,
    plant: Annotated[
        str,
        options.plant_option(
            "sim: simulate. lab: drive the robots of the log's lab. emulated: emulate that lab "
            "in virtual time."
        ),
    ] = "sim",
    yes: options.Yes = False,
    unattended: options.Unattended = False,
    out: options.LogFolder = None,
    dry_run: options.DryRun = False,
    quiet: options.Quiet = False,
    serve: options.Serve = False,
    port: options.ServePort = None,
    json: options.StatsJson = False,
) -> int:
    """Run the trial of a log again, with the spec and seed in the log, and compare the two logs.

    A trial in virtual time repeats exactly on its plant: the exit code is 1 if the two logs differ
    in content. With --set the trial is another one, of another controller for instance, and the
    total errors of both are printed. The trial of a log from a lab is simulated too; robots move
    only with --plant lab.

    Example: tetractl rerun logs/demo/trial-003.mcap
    """
    from tetractl.log.read.reader import trial_of
    from tetractl.log.read.salvage import scan
    from tetractl.run.task import log_path

    log = find_log(log)
    trial = trial_of(scan(log))
    how = RunOptions(out, 1, False, dry_run, quiet, yes, wanted_port(serve, port), json, unattended)
    number = trial.start.trial
    code, folder = run_command(_recorded(trial, plant, sets or ()), how, number)
    if code == Exit.DONE and not dry_run:
        again = log_path(folder, number)
        return _compare(log, again) if not sets else _errors_of(log, again, trial.start.setup.unit)
    return code


def _errors_of(was: Path, again: Path, unit: str) -> int:
    """Print the total errors [unit] of the trials of two logs with different specs."""
    from tetractl.log.read.reader import result_of
    from tetractl.log.read.salvage import scan

    old, new = (result_of(scan(log)).result.total_error for log in (was, again))
    ui.tell(
        f"total error {new:.2f} {unit}, in the log {old:.2f} {unit}; their specs differ, so "
        "nothing else is compared"
    )
    return Exit.DONE


def _recorded(trial: "TrialLog", plant: str, sets: Sequence[str]) -> "LoadedSpec":
    """Return the spec of a log with values replaced, changed to the given plant.

    No calibration file is read: the spec in a log of the lab has the calibration's values.
    """
    from tetractl.experiment.lab_section import LabSection
    from tetractl.experiment.load import LoadedSpec, parse_written
    from tetractl.experiment.plants import lab_as, on_plant

    start, experiment = trial.start, trial.experiment
    if sets:
        experiment = parse_written(start.resolved, "the log's spec", sets).experiment
    lab = experiment.plant
    spec = LoadedSpec(experiment, start.spec_text, start.spec_name, attached=start.attached)
    if plant == "sim" or not isinstance(lab, LabSection):
        return on_plant(spec, plant)
    changed: dict[str, Any] = {"plant": lab_as(plant, lab)}
    if experiment.chosen is not None:  # no robot is where the log's trial began
        changed["chosen"] = experiment.chosen.sought()
    return replace(spec, experiment=experiment.model_copy(update=changed))


def _compare(log: Path, again: Path) -> int:
    """Print whether two logs of a trial have the same content; return FAILED if they differ."""
    from tetractl.log.format.channels import RESOLVED_SPEC
    from tetractl.log.read.reader import result_of, trial_of
    from tetractl.log.read.salvage import scan
    from tetractl.replay.comparison import log_differences
    from tetractl.replay.verify import host_differences

    was, is_now = scan(log), scan(again)
    first, second = result_of(was), result_of(is_now)
    plants = [one.experiment.plant for one in (first, second)]
    if plants[0].type != plants[1].type or plants[0].real_time:
        names = {"sim": "simulated", "lab": "of the lab"}
        one, two = (names.get(plant.type, plant.type) for plant in plants)
        ui.tell(f"the log is {one}, the new one {two}: the two are not compared")
        return Exit.DONE
    one, two = was.content_digest, is_now.content_digest
    if one == two:
        ui.tell(f"the content digests agree: {one}")
        return Exit.DONE
    ui.tell(f"the content digests differ: {one} in {log}, {two} in {again}")
    ui.tell(*(f"  {one}" for one in islice(log_differences(is_now, was), 1)))
    if first.recovered or not first.outcome.complete:
        ui.tell(f"  {log} is damaged, or its trial did not run to its end")
    if was.text(RESOLVED_SPEC) != is_now.text(RESOLVED_SPEC):
        ui.tell("  the log's spec lacks fields of this tetractl")
    ui.tell(*(f"  {line}" for line in host_differences(trial_of(was))))
    return Exit.FAILED

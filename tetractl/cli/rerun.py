"""`tetractl rerun`: runs a recorded trial again, optionally with values replaced.

The spec and the seed come from the log.
"""

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

from tetractl.cli import options, ui
from tetractl.cli.trials import RunOptions, choose_port, run_command
from tetractl.core.errors import Exit
from tetractl.log.read.find import find_log

if TYPE_CHECKING:
    from tetractl.log.read.raw_log import RawLog
    from tetractl.log.read.trial_log import TrialLog
    from tetractl.spec.loaded_spec import LoadedSpec

PLANT_NAMES = {"sim": "a simulation", "lab": "the lab", "emulated": "an emulated lab"}
"""Where a log comes from, by the type of its plant."""


def rerun(
    log: options.Log,
    sets: options.Sets = None,
    plant: Annotated[
        str,
        options.plant_option(
            "sim: simulate. lab: drive the robots of the log's lab. emulated: emulate this "
            "lab in virtual time."
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
    """Run the trial of a log again, and compare the two logs.

    The command uses the spec and the seed in the log. A trial in virtual time must repeat exactly:
    if the two logs differ in content, the exit code is 1. With --set, you change the spec, for
    instance to another controller; the command then prints the total errors of both trials. If the
    log comes from a lab, the new trial is simulated. Robots move only with --plant lab.

    Example: tetractl rerun logs/demo/trial-003.mcap
    """
    from tetractl.log.read.reader import trial_of
    from tetractl.log.read.salvage import scan
    from tetractl.run.logged_trial import log_path
    from tetractl.spec.load import parse_resolved

    raw_log = scan(find_log(log))
    trial = trial_of(raw_log)
    spec = trial.spec
    if sets:
        changed = parse_resolved(trial.start.resolved, "the log's spec", sets)
        spec = replace(spec, experiment=changed.experiment)
    run_options = RunOptions(
        out=out,
        dry_run=dry_run,
        quiet=quiet,
        yes=yes,
        port=choose_port(serve, port),
        json=json,
        unattended=unattended,
    )
    trial_index = trial.start.trial
    code, folder = run_command(_select_plant(spec, plant), run_options, only_trial=trial_index)
    if code != Exit.DONE or dry_run:
        return code
    raw_again = scan(log_path(folder, trial_index))
    if spec.hash == trial.spec.hash:
        return _compare_logs(raw_log, trial, raw_again)
    _print_errors(raw_log, raw_again)
    return Exit.DONE


def _select_plant(spec: "LoadedSpec", plant: str) -> "LoadedSpec":
    """Return the spec of a log for another plant: simulated robots, or a real or emulated lab.

    No calibration file is read for a log of a lab, because the spec in the log already has the
    calibration's values.
    """
    from tetractl.spec.lab_section import LabSection
    from tetractl.spec.plants import convert_lab, select_plant

    experiment = spec.experiment
    lab = experiment.plant
    if plant == "sim" or not isinstance(lab, LabSection):
        return select_plant(spec, plant)
    changed: dict[str, Any] = {"plant": convert_lab(plant, lab)}
    if experiment.chosen is not None:  # no robot is where the log's trial began
        changed["chosen"] = experiment.chosen.sought()
    return replace(spec, experiment=experiment.model_copy(update=changed))


def _print_errors(raw_log: "RawLog", raw_again: "RawLog") -> None:
    """Print the total errors of two logged trials whose specs differ."""
    from tetractl.log.read.reader import result_of

    error = result_of(raw_log).result.total_error
    error_again = result_of(raw_again).result.total_error
    unit = raw_log.run.unit
    ui.print_messages(
        f"the total error is {error_again:.2f} {unit} now, and was {error:.2f} {unit} in "
        "the log; nothing else is compared, because the two specs differ"
    )


def _compare_logs(raw_log: "RawLog", trial: "TrialLog", raw_again: "RawLog") -> int:
    """Print whether two logs of a trial have the same content. Return FAILED if they differ."""
    from tetractl.log.format.channels import RESOLVED_SPEC
    from tetractl.log.read.reader import result_of
    from tetractl.verification.log_comparison import log_differences
    from tetractl.verification.verify import host_differences

    plant = trial.experiment.plant
    plant_again = result_of(raw_again).experiment.plant
    if plant.type != plant_again.type or plant.real_time:
        name = PLANT_NAMES.get(plant.type, plant.type)
        name_again = PLANT_NAMES.get(plant_again.type, plant_again.type)
        names = f"the log comes from {name}, but the new log comes from {name_again}"
        if name == name_again:
            names = f"both logs come from {name}"
        ui.print_messages(f"{names}, so they are not compared")
        return Exit.DONE
    digest = raw_log.content_digest
    digest_again = raw_again.content_digest
    if digest == digest_again:
        ui.print_messages(f"the content digests agree: {digest}")
        return Exit.DONE
    both_digests = f"{digest} in {raw_log.path}, {digest_again} in {raw_again.path}"
    ui.print_messages(f"the content digests differ: {both_digests}")
    first_difference = next(log_differences(raw_again, raw_log), None)
    if first_difference is not None:
        ui.print_messages(f"  {first_difference}")
    if raw_log.damaged or not result_of(raw_log).outcome.complete:
        ui.print_messages(f"  {raw_log.path} is damaged, or its trial was cut short")
    if raw_log.attachment_text(RESOLVED_SPEC) != raw_again.attachment_text(RESOLVED_SPEC):
        ui.print_messages("  the spec in the log lacks fields that this version of tetractl has")
    for line in host_differences(trial):
        ui.print_messages(f"  {line}")
    return Exit.FAILED

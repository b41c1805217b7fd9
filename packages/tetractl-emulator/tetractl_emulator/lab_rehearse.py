"""The command `tetractl lab rehearse`: it tests an emulated lab against random faults.

Each *day* is one randomised test run, and each invariant that must hold is checked.
"""

import gc
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import nullcontext, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tetractl.cli import ui
from tetractl.cli.options import Sets, Spec, option, out_option, switch
from tetractl.core.errors import AbortError, Exit, UsageError
from tetractl.run.interrupt import interrupted_once
from tetractl.tools.files import write_atomically
from tetractl.tools.table.table import pluralize
from tetractl.tools.terminal import is_terminal

SPEC_HINT = "the spec itself causes this abort: correct the spec first, then rehearse it"

SAMPLING_VERSION = 6
"""Version of how days are sampled.

Days in a folder that were sampled in another version are not continued.
"""
WATCHDOG_S = 0.25
"""Time without a command after which robots stop, if the spec states none [s]."""
DAYS_MAX = 1_000_000
"""Maximum number of days of one command, which are some weeks of computing."""

if TYPE_CHECKING:
    from tetractl.spec.experiment import Experiment
    from tetractl.spec.lab_section import LabSection
    from tetractl_emulator.rehearsal.day import DayOutcome
    from tetractl_emulator.rehearsal.summary import DaySummary
    from tetractl_emulator.rehearsal.truth import Truth, Violation


def rehearse(
    spec: Spec,
    sets: Sets = None,
    days: Annotated[
        int,
        option(
            "N",
            "Number of days to rehearse. A day is one trial with random faults.",
            min=1,
            max=DAYS_MAX,
        ),
    ] = 20,
    seed: Annotated[int, option("S", "Seed that determines the faults of all days.", min=0)] = 1,
    first: Annotated[
        int,
        option(
            "N",
            "Number of the first day. The seed and a day's number together determine the "
            "faults of that day.",
            min=0,
            max=DAYS_MAX,
        ),
    ] = 0,
    faults: Annotated[
        bool, switch("Inject faults. With --no-faults, every trial must finish without an abort.")
    ] = True,
    jobs: Annotated[int, option("N", "Number of days to run at the same time.", min=1)] = 1,
    out: Annotated[
        Path | None,
        out_option(
            "DIR",
            "Folder for the results of the days and for the fault scripts that reproduce "
            "violations. Days whose results are already in the folder are not run again. "
            "[rehearsal-SEED]",
        ),
    ] = None,
) -> int:
    """Test a lab against random faults in virtual time, without hardware.

    Each day is a trial with faults that the seed determines. An observer that knows how the robots
    truly move checks rules that must always hold (invariants). If a day violates a rule, the
    command writes the faults of that day to a script for `plant.faults`. Twenty days take a few
    minutes, or up to five if the lab has a picture camera. Without a terminal, the command prints
    one line for each day.

    Example: tetractl lab rehearse experiments/three_m3pi_lab.yaml --days 200 --jobs 2
    """
    from tetractl.control.methods.build import warm_up
    from tetractl.core.plan import Outcome
    from tetractl.run.executors import call_in_workers
    from tetractl.run.logged_trial import run_logged
    from tetractl.run.store import RecordStore
    from tetractl.spec.load import load_spec
    from tetractl.spec.plants import select_plant
    from tetractl_emulator.rehearsal.summary import (
        SUMMARY_FIELDS,
        describe_endings,
        fault_table,
        frequent_reasons,
    )

    loaded = select_plant(ui.load_spec_file(spec, sets), "emulated")
    if loaded.experiment.plant.real_time:
        raise UsageError(
            "a rehearsal emulates the whole lab, but the spec says that a device of this lab "
            "is real",
            "remove the field `real` from the spec's lab",
        )
    loaded.experiment.plant.require_devices()
    warm_up(loaded.experiment, lambda text: ui.announce_compiling(False, text))
    short_sets = (*(sets or ()), "controller.time_limit=1")
    short_spec = select_plant(load_spec(spec, short_sets), "emulated")
    # what it loads, no day has to load; no cells may have been found
    allow_abort = suppress(AbortError) if loaded.experiment.must_choose_robots else nullcontext()
    with tempfile.TemporaryDirectory() as scratch, allow_abort:
        faultless = run_logged(short_spec, Path(scratch))
        if faultless.outcome is Outcome.ABORTED:
            raise AbortError(
                f"a trial without any faults was aborted: {faultless.reason}", SPEC_HINT
            )
    gc.freeze()  # what all days use need not be searched for garbage on each
    folder = out or Path(f"rehearsal-{seed}")
    result_store = RecordStore(
        folder, f"{loaded.hash} {seed} {faults} {SAMPLING_VERSION}", SUMMARY_FIELDS
    )
    rows = result_store.records
    day_indices = range(first, first + days)
    run_one_day = partial(
        rehearse_day, spec, tuple(sets or ()), seed, with_faults=faults, folder=folder
    )
    start_s = time.monotonic()
    is_interrupted = False
    try:
        with result_store.opened(), interrupted_once(), ui.show_progress("days") as show_progress:
            waiting_days = [day for day in day_indices if day not in rows]
            for done_count, row in enumerate(
                call_in_workers(run_one_day, waiting_days, jobs, ui.print_messages), start=1
            ):
                result_store.add_record(row["day"], row)
                show_progress(done_count, len(waiting_days))
                if not is_terminal(sys.stderr):
                    remaining_s = (
                        (time.monotonic() - start_s) / done_count * (len(waiting_days) - done_count)
                    )
                    remaining = (
                        f"{remaining_s / 60:.0f} min"
                        if remaining_s >= 90
                        else f"{remaining_s:.0f} s"
                    )
                    remaining_note = (
                        f", about {remaining} more" if done_count < len(waiting_days) else ""
                    )
                    ui.print_messages(
                        f"{done_count} of {len(waiting_days)}{remaining_note}: "
                        f"day {row['day']}: {row['ended']}"
                    )
                for name, at_s, finding in row["violations"]:
                    ui.print_messages(f"day {row['day']}, {at_s:.2f} s: {name}: {finding}")
    except KeyboardInterrupt:
        is_interrupted = True
        ui.print_messages(
            f"interrupted; to continue, run the same command again with --out {folder}"
        )
    completed_rows = [rows[day] for day in day_indices if day in rows]
    violating_rows = [row for row in completed_rows if row["violations"]]
    days_text = f"{len(completed_rows)} {pluralize('day', len(completed_rows))}"
    violations_text = f"{len(violating_rows)} {pluralize('violation', len(violating_rows))}"
    totals = f"{days_text}, {violations_text}"
    sections = (
        fault_table(completed_rows),
        frequent_reasons(completed_rows),
        describe_endings(completed_rows),
        totals,
    )
    print(*filter(None, sections), sep="\n\n")
    if violating_rows:
        return Exit.FAILED
    return Exit.INTERRUPTED if is_interrupted else Exit.DONE


def rehearse_day(
    spec: Path,
    sets: Sequence[str],
    seed: int,
    day: int,
    with_faults: bool = True,
    folder: Path | None = None,
) -> "DaySummary":
    """Run one randomised test run, check its invariants, and return a summary.

    Args:
        spec: The spec.
        sets: Settings that replace values of the spec.
        seed: Seed of all test runs.
        day: Index of this test run.
        with_faults: Whether to inject faults.
        folder: Where to write the script of a test run that violated an invariant. None to write no
            script.
    """
    from tetractl.plant.lab_plant import RigSection
    from tetractl.spec.load import load_spec
    from tetractl.spec.plants import select_plant
    from tetractl.spec.yaml.core_yaml import format_yaml
    from tetractl_emulator.rehearsal.day import run_day
    from tetractl_emulator.rehearsal.day_plan import plan_of_day
    from tetractl_emulator.rehearsal.summary import summarize_day

    experiment = select_plant(load_spec(spec, sets), "emulated").experiment
    lab = experiment.plant
    assert isinstance(lab, RigSection), "`select_plant` has chosen a lab"
    if "deadline" in type(experiment.controller).model_fields:
        sets = (*sets, "controller.deadline=60")  # no search is cut short
    plan = plan_of_day(seed, day, lab, experiment.setup, experiment.must_choose_robots, with_faults)
    sets = (*sets, *plan.settings)
    with tempfile.TemporaryDirectory() as scratch:
        outcome = run_day(spec, sets, plan, Path(scratch))
        start_s = time.process_time()
        experiment_of_day = select_plant(load_spec(spec, sets), "emulated").experiment
        truth, violations = observe_day(outcome, experiment_of_day, lab)
        row = summarize_day(day, truth, violations, time.process_time() - start_s)
    if violations and folder is not None:
        about = f"seed {seed}, day {day}: {violations[0].name}; the trial's seed is {plan.seed}"
        text = format_yaml(plan.script() | {"about": about})
        write_atomically(folder / f"seed-{seed}-day-{day}.yaml", text.encode())
    return row


def observe_day(
    outcome: "DayOutcome", experiment: "Experiment", lab: "LabSection"
) -> "tuple[Truth, Sequence[Violation]]":
    """Determine what truly happened in a test run, and which invariants it violated.

    Args:
        outcome: The test run.
        experiment: The experiment.
        lab: The lab.
    """
    from tetractl_emulator.rehearsal.invariants import violations
    from tetractl_emulator.rehearsal.outcome_invariants import outcome_violations
    from tetractl_emulator.rehearsal.truth import Truth

    watchdog_s = (experiment.wheels.watchdog if experiment.wheels else None) or WATCHDOG_S
    has_cells = lab.actuator.type == "field"
    truth = Truth(outcome, experiment.setup, lab.limits, watchdog_s, can_stand_still=not has_cells)
    return truth, outcome_violations(truth) if has_cells else violations(truth)

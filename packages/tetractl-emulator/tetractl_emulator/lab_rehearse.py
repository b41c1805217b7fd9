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
from tetractl.tools.files import save_whole
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
    from tetractl_emulator.rehearsal.summary import DayRow
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

    Each day is a trial with faults that the seed determines. An observer that knows the truth
    checks invariants. If a day violates one, its faults are written to a script for `plant.faults`.
    Twenty days take a few minutes, or up to five if the lab has a picture camera. Without a
    terminal, a line is printed for each day.

    Example: tetractl lab rehearse experiments/three_m3pi_lab.yaml --days 200 --jobs 2
    """
    from tetractl.control.methods.build import warm_up
    from tetractl.core.plan import Outcome
    from tetractl.run.executors import called
    from tetractl.run.logged_trial import run_logged
    from tetractl.run.store import RecordStore
    from tetractl.spec.load import load_spec
    from tetractl.spec.plants import on_plant
    from tetractl_emulator.rehearsal.summary import FIELDS, reasons, summary, table

    loaded = on_plant(ui.load(spec, sets), "emulated")
    if loaded.experiment.plant.real_time:
        raise UsageError(
            "a rehearsal emulates the whole lab, but the spec says that a device of this lab "
            "is real",
            "remove the field `real` from the spec's lab",
        )
    loaded.experiment.plant.require_devices()
    warm_up(loaded.experiment, lambda text: ui.announce_compiling(False, text))
    short_sets = (*(sets or ()), "controller.time_limit=1")
    short_spec = on_plant(load_spec(spec, short_sets), "emulated")
    # what it loads, no day has to load; no cells may have been found
    may_fail = suppress(AbortError) if loaded.experiment.open else nullcontext()
    with tempfile.TemporaryDirectory() as scratch, may_fail:
        faultless = run_logged(short_spec, Path(scratch))
        if faultless.outcome is Outcome.ABORTED:
            raise AbortError(
                f"a trial without any faults was aborted: {faultless.reason}", SPEC_HINT
            )
    gc.freeze()  # what all days use need not be searched for garbage on each
    folder = out or Path(f"rehearsal-{seed}")
    store = RecordStore(folder, f"{loaded.hash} {seed} {faults} {SAMPLING_VERSION}", FIELDS)
    rows = store.records
    day_indices = range(first, first + days)
    run_one_day = partial(rehearsed, spec, tuple(sets or ()), seed, bad=faults, folder=folder)
    began_s = time.monotonic()
    interrupted = False
    try:
        with store.opened(), interrupted_once(), ui.progress("days") as show:
            waiting = [day for day in day_indices if day not in rows]
            for done_count, row in enumerate(called(run_one_day, waiting, jobs, ui.tell), start=1):
                store.add(row["day"], row)
                show(done_count, len(waiting))
                if not is_terminal(sys.stderr):
                    left_s = (time.monotonic() - began_s) / done_count * (len(waiting) - done_count)
                    remaining = f"{left_s / 60:.0f} min" if left_s >= 90 else f"{left_s:.0f} s"
                    remaining_note = (
                        f", about {remaining} more" if done_count < len(waiting) else ""
                    )
                    ui.tell(
                        f"{done_count} of {len(waiting)}{remaining_note}: "
                        f"day {row['day']}: {row['ended']}"
                    )
                for name, at_s, finding in row["violations"]:
                    ui.tell(f"day {row['day']}, {at_s:.2f} s: {name}: {finding}")
    except KeyboardInterrupt:
        interrupted = True
        ui.tell(f"interrupted; to continue, run the same command again with --out {folder}")
    played = [rows[day] for day in day_indices if day in rows]
    violated = [row for row in played if row["violations"]]
    played_days = f"{len(played)} {pluralize('day', len(played))}"
    violations = f"{len(violated)} {pluralize('violation', len(violated))}"
    totals = f"{played_days}, {violations}"
    sections = table(played), reasons(played), summary(played), totals
    print(*filter(None, sections), sep="\n\n")
    if violated:
        return Exit.FAILED
    return Exit.INTERRUPTED if interrupted else Exit.DONE


def rehearsed(
    spec: Path,
    sets: Sequence[str],
    seed: int,
    day: int,
    bad: bool = True,
    folder: Path | None = None,
) -> "DayRow":
    """Run one randomised test run, check it, and return a summary of it.

    Args:
        spec: The spec.
        sets: Settings that replace values of the spec.
        seed: Seed of all test runs.
        day: Index of this test run.
        bad: Whether to inject faults.
        folder: Where to write the script of a test run that violated an invariant. None to write no
            script.
    """
    from tetractl.plant.lab_plant import RigSection
    from tetractl.spec.load import load_spec
    from tetractl.spec.plants import on_plant
    from tetractl.spec.yaml.core_yaml import dump
    from tetractl_emulator.rehearsal.day import run_day
    from tetractl_emulator.rehearsal.day_plan import plan_of_day
    from tetractl_emulator.rehearsal.summary import row_of

    experiment = on_plant(load_spec(spec, sets), "emulated").experiment
    lab = experiment.plant
    assert isinstance(lab, RigSection), "`on_plant` has chosen a lab"
    if "deadline" in type(experiment.controller).model_fields:
        sets = (*sets, "controller.deadline=60")  # no search is cut short
    plan = plan_of_day(seed, day, lab, experiment.setup, experiment.open, bad)
    sets = (*sets, *plan.settings)
    with tempfile.TemporaryDirectory() as scratch:
        outcome = run_day(spec, sets, plan, Path(scratch))
        began_s = time.process_time()
        experiment_of_day = on_plant(load_spec(spec, sets), "emulated").experiment
        truth, violations = observed(outcome, experiment_of_day, lab)
        row = row_of(day, truth, violations, time.process_time() - began_s)
    if violations and folder is not None:
        summary = f"seed {seed}, day {day}: {violations[0].name}, at seed {plan.seed} of the trial"
        text = dump(plan.script() | {"about": summary})
        save_whole(folder / f"seed-{seed}-day-{day}.yaml", text.encode())
    return row


def observed(
    day: "DayOutcome", experiment: "Experiment", lab: "LabSection"
) -> "tuple[Truth, Sequence[Violation]]":
    """Determine what truly happened in a test run, and which invariants it violated.

    Args:
        day: The test run.
        experiment: The experiment.
        lab: The lab.
    """
    from tetractl_emulator.rehearsal.invariants import violations
    from tetractl_emulator.rehearsal.outcome_invariants import outcome_violations
    from tetractl_emulator.rehearsal.truth import Truth

    watchdog_s = (experiment.wheels.watchdog if experiment.wheels else None) or WATCHDOG_S
    has_cells = lab.actuator.type == "field"
    truth = Truth(day, experiment.setup, lab.limits, watchdog_s, halts=not has_cells)
    return truth, outcome_violations(truth) if has_cells else violations(truth)

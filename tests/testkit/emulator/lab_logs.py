"""Logs of short trials in the emulated lab and with the emulated microscope."""

from collections.abc import Sequence
from pathlib import Path

from testkit.emulator.bench_agreement import LAB
from testkit.emulator.virtual_lab import virtual_dish, virtual_lab
from tetractl.run.logged_trial import log_path, run_logged
from tetractl.spec.load import load_spec


def lab_log(folder: Path, sets: Sequence[str] = ()) -> Path:
    """Run one trial of the emulated lab in virtual time; return its log."""
    short = ("controller.time_limit=1.8", "controller.horizon_max=8", "controller.deadline=60")
    loaded = load_spec(LAB, [*short, *sets])
    lossy = "emulation: {actuator: {loss: 0.3}}"
    with virtual_lab(None, spec=loaded, script=lossy) as lab:
        run_logged(lab.spec, folder)
    return log_path(folder, 0)


def dish_log(folder: Path) -> Path:
    """Run one trial of cells under the emulated microscope in virtual time; return its log."""
    short = ("controller.time_limit=4", "controller.deadline=60")
    with virtual_dish(folder, sets=short) as lab:
        run_logged(lab.spec, folder)
    return log_path(folder, 0)

"""Runs one trial of a spec that a command made, as `tetractl run` does: limits, consent, guard."""

from pathlib import Path
from typing import TYPE_CHECKING

from tetractl.cli.caution import need_consent
from tetractl.core.errors import Exit, TetractlError

if TYPE_CHECKING:
    from tetractl.experiment.load import LoadedSpec


def drive(loaded: "LoadedSpec", folder: Path, trial: int, yes: bool) -> Path:
    """Run a trial, with its log in a folder, and return the log.

    In the lab this needs consent and passes the same checks as a run; the space bar and Esc stop
    the robots. Raises TetractlError for a trial that was aborted, KeyboardInterrupt for one that
    was interrupted.
    """
    from rich.console import Console

    from tetractl.cli.hangup import hung_up_unread
    from tetractl.cli.run import STOPPING, run_todo
    from tetractl.cli.streams import hurrier
    from tetractl.control.build import warm_up
    from tetractl.core.plan import Outcome
    from tetractl.run.batch import log_path
    from tetractl.run.folder import batch_folder
    from tetractl.run.interrupt import Interrupt, leave_on_signals
    from tetractl.run.limits import check

    check(loaded.experiment)
    in_lab = not loaded.experiment.plant.simulated
    if in_lab:
        need_consent(yes)
    console = Console(stderr=True, quiet=not in_lab)
    with batch_folder(loaded.experiment, folder, False):
        warm_up(loaded.experiment, lambda text: console.print(text, highlight=False))
        interrupt = Interrupt(hurrier(STOPPING))
        leave_on_signals(Exit.INTERRUPTED)
        with hung_up_unread(in_lab), interrupt.watch(robots=in_lab):
            report = run_todo(loaded, folder, [trial], 1, console, interrupt, None, yes)
    if report.refused:
        raise report.refused
    result = report.results.get(trial)
    if result is None or result.outcome is Outcome.INTERRUPTED:
        raise KeyboardInterrupt
    if result.outcome is Outcome.ABORTED:
        raise TetractlError(f"the robots were stopped: {result.reason}", f"log in {folder}")
    return log_path(folder, trial)

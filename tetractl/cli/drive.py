"""Runs one trial of a spec that a command made, as `tetractl run` does: limits, consent, guard."""

from pathlib import Path
from typing import TYPE_CHECKING

from tetractl.cli.caution import need_consent
from tetractl.core.errors import TetractlError

if TYPE_CHECKING:
    from tetractl.experiment.load import LoadedSpec


def drive(loaded: "LoadedSpec", folder: Path, trial: int, yes: bool) -> Path:
    """Run a trial, with its log in a folder, and return the log.

    In the lab this needs consent and passes the same checks as a run; the space bar and Esc stop
    the robots. Raises TetractlError for a trial that was aborted, KeyboardInterrupt for one that
    was interrupted.
    """
    from rich.console import Console

    from tetractl.cli.trials import run_trials, stoppable
    from tetractl.core.plan import Outcome
    from tetractl.run.limits import check
    from tetractl.run.store import LogStore
    from tetractl.run.task import log_path

    check(loaded.experiment)
    in_lab = not loaded.experiment.plant.simulated
    if in_lab:
        need_consent(yes)
    console, store = Console(stderr=True, quiet=not in_lab), LogStore(folder, loaded.experiment)
    with store.opened(False), stoppable(loaded.experiment, console) as interrupt:
        report = run_trials(loaded, store, [trial], 1, console, interrupt, yes)
    for error in report.errors.values():
        raise error
    result = next(iter(report.results.values()), None)
    if result is None or result.outcome is Outcome.INTERRUPTED:
        raise KeyboardInterrupt
    if result.outcome is Outcome.ABORTED:
        raise TetractlError(f"the robots were stopped: {result.reason}", f"log in {folder}")
    return log_path(folder, trial)

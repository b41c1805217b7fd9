"""`tetractl analyze`: how well the robots of a spec can be steered together, in simulation."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

from tetractl.cli import options
from tetractl.cli.options import argument, option
from tetractl.cli.stats import show
from tetractl.cli.trials import RunOptions, load_to_run, prepare_in_lines, stop_on_signals
from tetractl.core.errors import Exit
from tetractl.tools.table.table_files import format_json
from tetractl.tools.table.terminal_table import open_console, print_tables

if TYPE_CHECKING:
    from tetractl.run.batch import Report
    from tetractl.run.interrupt import Interrupt
    from tetractl.spec.loaded_spec import LoadedSpec

TRIALS = 20


def analyze(
    spec: Annotated[Path, argument("SPEC", "Spec file of the experiment to analyze.")],
    trials: Annotated[int, option("N", "Number of simulated trials.", min=1)] = TRIALS,
    seed: options.Seed = None,
    sets: options.Sets = None,
    jobs: Annotated[
        int,
        option("N", "Number of trials to run at the same time, each in its own process.", min=1),
    ] = 1,
    as_json: options.AsJson = False,
) -> int:
    """Simulate trials, and report how well the robots can be steered together.

    The command prints how many independent combinations of the robots' end positions the common
    signal can change, which two robots have the most similar turning rates a, and the statistics of
    the trials, as `stats` prints them. It keeps no logs; to keep them, use `run`.

    Example: tetractl analyze experiments/tetrahymena.yaml
    """
    from tetractl.reach.facts import facts_items, facts_table
    from tetractl.spec.yaml.settings import FieldValue
    from tetractl.statistics.as_json import batch_items
    from tetractl.statistics.describe import contrast, describe
    from tetractl.statistics.open_batch import open_batch

    of_spec = [
        FieldValue("trials.count", trials, "--trials"),
        FieldValue("trials.seed", seed, "--seed"),
    ]
    loaded = load_to_run(spec, sets or [], "sim", of_spec)
    experiment = loaded.experiment
    table = facts_table(experiment)
    if table and not as_json:
        print_tables([table])
    with TemporaryDirectory() as temporary, stop_on_signals(loaded, RunOptions()) as interrupt:
        folder = Path(temporary) / "trials"
        report = _simulate(loaded, folder, jobs, interrupt)
        for error in report.errors.values():
            raise error
        if interrupt.requested:
            raise KeyboardInterrupt
        statistics = describe(open_batch([folder]), experiment.name)
        if as_json:
            print(format_json(facts_items(experiment) | batch_items(statistics)))
        else:
            show(contrast([statistics]), "table")
    return Exit.DONE


def _simulate(loaded: "LoadedSpec", folder: Path, jobs: int, interrupt: "Interrupt") -> "Report":
    """Run all trials of a spec, with their logs in a folder. Show progress only on a terminal."""
    from tetractl.run.batch import OnFailure, run_batch
    from tetractl.run.store import Store
    from tetractl.run.task import batch_tasks

    experiment = loaded.experiment
    store = Store.of_batch(folder, experiment)
    tasks = batch_tasks(loaded, store.unfinished)
    console = open_console(stderr=True)
    console.quiet = not console.is_terminal
    lines = prepare_in_lines(console, experiment.units.length, len(tasks), jobs, interrupt, ())
    with store.opened(False), lines as (executor, observer):
        return run_batch(tasks, store, executor, observer, OnFailure.of_batch(experiment.plant))

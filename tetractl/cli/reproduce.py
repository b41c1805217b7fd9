"""`tetractl reproduce`: the figures of published papers next to ours, each with a verdict."""

from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tetractl.cli import ui
from tetractl.cli.options import AsJson, argument, option, out_option, switch
from tetractl.cli.specs import examples
from tetractl.core.errors import Exit, UsageError
from tetractl.core.registries import PAPERS
from tetractl.core.table.table_files import json_text
from tetractl.core.table.terminal_table import print_tables
from tetractl.experiment.yaml.problems import did_you_mean

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tetractl.log.read.trial_log import TrialLog
    from tetractl.reproduce.paper import Runs

SEED = 20261128


def reproduce(
    papers: Annotated[list[str] | None, argument("[PAPER]...", "The papers, by name.")] = None,
    every: Annotated[bool, switch("Reproduce all papers.", "--all")] = False,
    trials: Annotated[
        int | None, option("N", "Number of trials of each kind. [20, or the paper's]", min=1)
    ] = None,
    jobs: Annotated[int, option("N", "Number of trials run at a time.", min=1)] = 1,
    out: Annotated[Path, out_option("DIR", "Folder for the logs.")] = Path("logs/reproduce"),
    as_json: AsJson = False,
) -> int:
    """Run what published papers did, and print each figure next to ours, with a verdict.

    Without a PAPER it lists them. Trials with a log in DIR are kept: an interrupted command goes on
    where it was. The exit code is 1 if a verdict differs from that of
    docs/explanation/reproduce.md.

    Example: tetractl reproduce khalil-2013 --jobs 2
    """
    from tetractl.reproduce.paper import Paper, figure_table

    names = PAPERS.names() if every else papers or []
    if not names and not as_json:
        print(*PAPERS.names(), sep="\n")
    for name in names:
        if name not in PAPERS:
            text = f"there is no paper '{name}'{did_you_mean(name, PAPERS.names())}"
            raise UsageError(text, f"the papers are {', '.join(PAPERS.names())}")
    same, found = True, dict[str, dict[str, Any]]()
    for name in names:
        paper: Paper = PAPERS.load(name)
        run = partial(_logs, trials=trials, jobs=jobs)
        logs = dict[str, Any]()
        for kind, arm in paper.arms.items():
            count = trials or arm.trials
            ui.tell(f"{out / name / kind}: {count} trials of {arm.example} {' '.join(arm.sets)}")
            logs[kind] = run(replace(arm, sets=(*arm.sets, *arm.then(logs))), out / name / kind)
        for kind, work in paper.work.items():
            ui.tell(f"{out / name / kind}: {trials or work.trials} times")
            logs[kind] = work.results(out / name / kind, SEED, trials or work.trials, jobs)
        figures = list(paper.figures(logs))
        found[name] = {"source": paper.source, "figures": [asdict(one) for one in figures]}
        if not as_json:
            print_tables([figure_table(name, paper.source, figures)])
        for one in figures:
            if one.verdict is not one.page:
                same = False
                ui.tell(f"{name}: {one.what}: {one.verdict}, but {one.page} on the page")
    if as_json:
        print(json_text({"papers": found or {name: {} for name in PAPERS.names()}}))
    return Exit.DONE if same else Exit.FAILED


def _logs(arm: "Runs", folder: Path, trials: int | None, jobs: int) -> "Sequence[TrialLog]":
    """Run the trials of an arm that its folder lacks; return the first `trials`, all complete."""
    from tetractl.api import run_batch
    from tetractl.experiment.load import load_spec
    from tetractl.log.read.reader import read_trial
    from tetractl.run.task import log_path

    count = trials or arm.trials
    settings = (*arm.sets, f"trials.count={count}", f"trials.seed={SEED}")
    spec = load_spec(examples()[arm.example], settings)
    run_batch(spec, folder, jobs=jobs, resume=True)
    return [read_trial(log_path(folder, trial)) for trial in range(count)]

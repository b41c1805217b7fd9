"""`tetractl reproduce`: the figures of published papers next to ours, each with a verdict."""

from functools import partial
from pathlib import Path
from typing import Annotated, Any

from tetractl.cli import ui
from tetractl.cli.options import AsJson, argument, option, out_option, switch
from tetractl.core.errors import Exit, UsageError
from tetractl.spec.yaml.problems import suggest_similar
from tetractl.tools.table.table_files import format_json
from tetractl.tools.table.terminal_table import print_tables
from tetractl_papers.registries import PAPERS


def reproduce(
    papers: Annotated[
        list[str] | None, argument("[PAPER]...", "Names of the papers to reproduce.")
    ] = None,
    all_papers: Annotated[bool, switch("Reproduce all papers.", "--all")] = False,
    trials: Annotated[
        int | None,
        option("N", "Number of trials of each kind. [20, or as many as the paper]", min=1),
    ] = None,
    jobs: Annotated[int, option("N", "Number of trials to run at the same time.", min=1)] = 1,
    out: Annotated[Path, out_option("DIR", "Folder for the logs.")] = Path("logs/reproduce"),
    as_json: AsJson = False,
) -> int:
    """Repeat experiments of published papers, and compare our figures with theirs.

    The command prints each published figure next to ours, with a verdict. Without a PAPER, it lists
    the papers. Trials that have a log in DIR are not run again, so that an interrupted command
    continues where it was. The exit code is 1 if a verdict differs from
    packages/tetractl-papers/README.md.

    Example: tetractl reproduce khalil-2013 --jobs 2
    """
    from tetractl.api.batches import run_batch
    from tetractl.spec.examples import find_examples
    from tetractl_papers.claim import assess
    from tetractl_papers.paper import Paper, convert_to_json, create_claims_table
    from tetractl_papers.trials import run_arms

    names = PAPERS.names() if all_papers else papers or []
    for name in names:
        if name not in PAPERS:
            problem = f"there is no paper named '{name}'{suggest_similar(name, PAPERS.names())}"
            raise UsageError(problem, f"the known papers are {', '.join(PAPERS.names())}")
    if not names and not as_json:
        print(*PAPERS.names(), sep="\n")
    complete_batch = partial(run_batch, jobs=jobs, resume=True)
    json_by_paper: dict[str, dict[str, Any]] = {}
    n_unexpected = 0
    for name in names:
        paper: Paper = PAPERS.load(name)
        results = run_arms(
            paper, out / name, find_examples(), trials, complete_batch, ui.print_messages
        )
        rows = [assess(claim, results) for claim in paper.claims]
        json_by_paper[name] = {
            "source": paper.source,
            "figures": [convert_to_json(row) for row in rows],
        }
        if not as_json:
            print_tables([create_claims_table(name, paper.source, rows)])
        unexpected_claims = [row for row in rows if row.verdict is not row.claim.expected]
        for row in unexpected_claims:
            claim = row.claim
            ui.print_messages(
                f"{name}: {claim.figure}: the result is {row.verdict}, but the page "
                f"states {claim.expected}"
            )
        n_unexpected += len(unexpected_claims)
    if as_json:
        print(format_json({"papers": json_by_paper or {name: {} for name in PAPERS.names()}}))
    return Exit.FAILED if n_unexpected else Exit.DONE

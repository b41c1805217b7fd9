"""Write the tables of reproduced papers into the page of tetractl-papers, between its markers.

Run `python docs/make_reproduce.py [FOLDER]` after a change of a paper: it does what `tetractl
reproduce --all --out FOLDER` does. Trials in FOLDER (logs/reproduce) are kept, so that what was
run before is only read.
"""

import sys
from functools import partial
from pathlib import Path

from tetractl_papers.claim import assess
from tetractl_papers.paper import create_claims_table
from tetractl_papers.registries import PAPERS
from tetractl_papers.trials import run_arms

from tetractl import run_batch
from tetractl.spec.examples import find_examples
from tetractl.tools.table.terminal_table import format_markdown

PAGE = Path(__file__).parents[1] / "packages/tetractl-papers/README.md"
BEGIN = "<!-- figures: begin -->\n"
END = "<!-- figures: end -->"


def tables(folder: Path) -> str:
    """Return the tables of all papers, from the trials in `folder`, of which it runs what lacks."""
    complete = partial(run_batch, resume=True)
    printed = []
    for name in PAPERS.names():
        paper = PAPERS.load(name)
        results = run_arms(paper, folder / name, find_examples(), None, complete, print)
        rows = [assess(claim, results) for claim in paper.claims]
        printed.append(create_claims_table(name, paper.source, rows))
    return format_markdown(printed).strip()


if __name__ == "__main__":
    folder = Path(*sys.argv[1:]) if len(sys.argv) > 1 else Path("logs/reproduce")
    page = PAGE.read_text(encoding="utf-8")
    before = page.partition(BEGIN)[0]
    after = page.partition(END)[2]
    PAGE.write_text(f"{before}{BEGIN}{tables(folder)}\n{END}{after}", encoding="utf-8")

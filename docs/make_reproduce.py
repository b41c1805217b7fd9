"""Write the figures of reproduced papers into docs/explanation/reproduce.md, between its markers.

Run `tetractl reproduce --all --json > docs/explanation/reproduce.json` after a change of a paper,
and then `python docs/make_reproduce.py`; a test fails while the page differs from that file.
"""

import json
from pathlib import Path

from tetractl.core.table.terminal_table import markdown
from tetractl.reproduce.paper import Figure, figure_table

FOLDER = Path(__file__).parent / "explanation"
PAGE, FOUND = FOLDER / "reproduce.md", FOLDER / "reproduce.json"
BEGIN, END = "<!-- figures: begin -->\n", "<!-- figures: end -->"


def page(current: str) -> str:
    """Return the page with the tables between its markers made again."""
    found = json.loads(FOUND.read_text(encoding="utf-8"))["papers"]
    tables = [
        figure_table(name, paper["source"], [Figure(**one) for one in paper["figures"]])
        for name, paper in found.items()
    ]
    before, after = current.partition(BEGIN)[0], current.partition(END)[2]
    return f"{before}{BEGIN}{markdown(tables).strip()}\n{END}{after}"


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")

"""Tests that the examples of different pages write their logs to different folders.

A folder that holds logs is refused, so a reader of one page could not follow another page with the
same folder. This once happened in front of a class, in the lesson after the tutorial.
"""

import re
from collections import defaultdict

from testkit.paths import ROOT

WRITTEN = re.compile(
    r"^\$? ?tetractl (?:run|play|rerun|study) (?:[^\n]|\\\n)*?(?:--out|-o)[ =](logs/[\w/-]+)"
    r"|run_(?:batch|trial|study)\([^()]*?\"(logs/[\w/-]+)\"",
    re.MULTILINE,
)
"""A command or a call that writes logs, with its folder."""
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "packages").glob("*/docs/**/*.md")),
]


def folders(text):
    """The folders that the examples of a page write to."""
    return {shell or python for shell, python in WRITTEN.findall(text)}


def test_no_two_pages_write_to_one_folder():
    pages = defaultdict(list)
    for page in PAGES:
        for folder in folders(page.read_text("utf-8")):
            pages[folder].append(str(page.relative_to(ROOT)))
    assert "logs/delayed" in pages
    assert "logs/three" in pages
    assert {folder: on for folder, on in pages.items() if len(on) > 1} == {}


def test_folders_are_found_on_any_line_of_a_command_and_in_python():
    text = "$ tetractl run a.yaml \\\n    --out logs/a\ntetractl stats logs/b\n"
    text += 'x = tetractl.run_batch(\n    spec, "logs/c"\n)\n'
    assert folders(text) == {"logs/a", "logs/c"}

"""Tests that all pages named in specs, templates, sources and error messages exist.

A page is named by its path from the top of the repository. In a file of a package, the path starts
at the top of the package. `docs/PAGE.md of tetractl-NAME` is a page of that package. Links between
pages are checked when the site is built.
"""

import re
from pathlib import Path

import pytest
from testkit.paths import ROOT, SOURCE_FOLDERS

ENDS = frozenset({".c", ".h", ".html", ".js", ".json", ".proto", ".py", ".toml", ".yaml"})
NAMED = re.compile(
    r"(?<![\w./-])((?:[\w.-]+/)*docs/[\w./-]+\.md)\b(?:[\s#*/]+of[\s#*/]+(tetractl-\w+))?"
)
"""A page, and the package of which it is: the two may stand on two lines of a comment."""


def sources():
    """The files in which pages may be named."""
    of_folders = [path for folder in SOURCE_FOLDERS for path in sorted((ROOT / folder).rglob("*"))]
    files = [path for path in of_folders if path.suffix in ENDS and path.is_file()]
    files.remove(Path(__file__))  # which names pages that are missing, below
    return [ROOT / "Makefile", *files]


def missing(path, text):
    """The pages that the text of a file names, and that do not exist."""
    parts = path.relative_to(ROOT).parts
    own_top = ROOT / "packages" / parts[1] if parts[0] == "packages" else ROOT
    for match in NAMED.finditer(text):
        page, package = match.groups()
        tops = [ROOT, own_top] if package is None else [ROOT / "packages" / package]
        if not any((top / page).is_file() for top in tops):
            yield page


@pytest.mark.long
def test_every_page_that_a_source_names_exists():
    files = sources()
    assert ROOT / "experiments" / "tetrahymena.yaml" in files
    assert ROOT / "tetractl" / "spec" / "templates" / "robots.yaml" in files
    named_wrongly = {
        f"{path.relative_to(ROOT)}: {page}"
        for path in files
        for page in missing(path, path.read_text("utf-8"))
    }
    assert named_wrongly == set()


@pytest.mark.parametrize(
    ("file", "text", "pages"),
    [
        ("experiments/a.yaml", "# see docs/tutorial.md.", []),
        ("experiments/a.yaml", "# see docs/none.md.", ["docs/none.md"]),
        ("experiments/a.yaml", "# see docs/cells.md", ["docs/cells.md"]),
        ("experiments/a.yaml", "# docs/cells.md of\n# tetractl-microscope", []),
        ("experiments/a.yaml", "# docs/tutorial.md of tetractl-microscope", ["docs/tutorial.md"]),
        ("packages/tetractl-microscope/a.py", '"docs/cells.md"', []),
        ("tetractl/a.py", '"packages/tetractl-microscope/docs/cells.md"', []),
    ],
)
def test_a_page_is_looked_for_where_it_is_named(file, text, pages):
    assert list(missing(ROOT / file, text)) == pages

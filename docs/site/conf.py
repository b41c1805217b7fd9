"""The documentation as a site: `make docs` builds it with Sphinx, from the pages as they are."""

from pathlib import Path

project = html_title = "tetractl"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
default_role = "code"  # in docstrings, as in Markdown
autodoc_typehints = "description"
add_module_names = False
autodoc_member_order = "bysource"
root_doc = "docs/site/index"
include_patterns = [
    "*.md",
    "docs/**.md",
    "docs/site/*.rst",
    "examples/*/README.md",
    "experiments/**/README.md",
    "packages/*/README.md",
    "packages/*/docs/**.md",
    "packages/*/tests/data/README.md",
    "firmware/README.md",
]
exclude_patterns = [".venv*", "logs", "build", "dist"]
myst_heading_anchors = 3  # headings are linked to as GitHub names them
suppress_warnings = ["misc.highlighting_failure"]  # diagrams of Mermaid, which needs a network
html_theme = "furo"  # its scripts and styles are copied into the site
html_copy_source = False
GAME = Path(__file__).parents[2] / "build" / "game"
html_extra_path = [str(GAME)] if GAME.exists() else []  # for "Try it now"; `make docs` makes it
highlight_language = "none"

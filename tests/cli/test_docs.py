"""Tests that README and docs/ show what the commands print."""

import json
import os
import re
import shutil
import subprocess
import sys
import warnings

import console
import make_cli
import pytest
from testkit.paths import ROOT
from testkit.running import TETRACTL

pytestmark = pytest.mark.slow

PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "packages").glob("*/docs/**/*.md")),
]
MEND = "see the difference with: python docs/console.py {} --write; git diff"


def _name(page):
    return str(page.relative_to(ROOT))


LONGEST = (
    "docs/tutorial.md",
    "docs/how-to/lesson.md",
    "docs/how-to/real-robots.md",
    "docs/how-to/study.md",
    "packages/tetractl-microscope/docs/track.md",
)
"""Pages whose examples take half a minute or more; shorter ones show the same commands."""


def _is_for_releases(page):
    """Whether a page is too long for each change: README's 60 trials, too, where only its words
    are compared, and not its numbers."""
    is_readme = _name(page) == "README.md"
    return _name(page) in LONGEST or (is_readme and not console.exact(page.read_text("utf-8")))


WITH_EXAMPLES = [
    pytest.param(page, id=_name(page), marks=pytest.mark.release if _is_for_releases(page) else ())
    for page in PAGES
    if "```console" in page.read_text("utf-8")
]


@pytest.mark.system
@pytest.mark.filterwarnings("default:.*its numbers were printed on")
@pytest.mark.parametrize("page", WITH_EXAMPLES)
def test_every_example_prints_what_the_page_shows(page):
    text = page.read_text("utf-8")
    exact = console.exact(text)
    if not exact:
        warnings.warn(
            f"{_name(page)}: its numbers were printed on {console.printed_on(text)},"
            f" this is {console.here()}: only the words are compared",
            stacklevel=1,
        )
    done = console.run(text)
    for (example, printed, code), after in zip(done, [*done[1:], None], strict=True):
        assert console.agrees(example.shown, printed, exact), (
            f"$ {example.command}\n{printed}\n{MEND.format(_name(page))}"
        )
        shows_its_code = after is not None and after[0].command == "echo $?"
        assert shows_its_code or code == 0, f"$ {example.command}\nexit code {code}\n{printed}"


@pytest.mark.system
def test_the_learner_of_the_page_exports_a_policy(tmp_path):
    pytest.importorskip("stable_baselines3")
    page = (ROOT / "docs" / "how-to" / "step-by-step.md").read_text("utf-8")
    (script,) = re.findall(r"```python title=learn\.py\n(.*?)```", page, re.DOTALL)
    lines = [line for line in script.splitlines() if line.strip()]
    assert len(lines) <= 12
    quick = {"learn(40_000, ": "learn(100, ", "eval_freq=1280": "eval_freq=200", "=40,": "=2,"}
    for slow, short in quick.items():
        assert slow in script
        script = script.replace(slow, short)
    (tmp_path / "learn.py").write_text(script)
    (tmp_path / "experiments").symlink_to(ROOT / "experiments")
    subprocess.run([sys.executable, "learn.py"], cwd=tmp_path, check=True)
    layers = json.loads((tmp_path / "cell.json").read_text())["layers"]
    assert [len(layer["bias"]) for layer in layers] == [64, 64, 2]  # the learner's default network
    assert len(layers[0]["weights"][0]) == 6  # features of one robot


def test_each_mean_of_which_bench_is_which_stands_on_the_page_it_names():
    page = ROOT / "docs/explanation/bench.md"
    text = page.read_text("utf-8")
    section = text.partition("## Which bench is which")[2].partition("\n## ")[0]
    rows = [line.split("|") for line in section.splitlines() if re.search(r"\d \[|\+-", line)]
    assert len(rows) == 6
    for *_, mean, where, _ in rows:
        target = re.search(r"\]\(([^)#]*)", where)
        assert target, where
        named = (page.parent / target[1] if target[1] else page).read_text("utf-8")
        numbers = re.match(r" ([\d.]+) (?:\[([\d.]+), ([\d.]+)\]|\+- ([\d.]+))", mean)
        assert numbers, mean
        for number in filter(None, numbers.groups()):
            assert number in named.replace(section, ""), (number, where)


@pytest.mark.system
@pytest.mark.parametrize(
    "page", [page for page in PAGES if any(console.programs(page.read_text("utf-8")))], ids=_name
)
def test_every_python_example_runs(page, tmp_path, monkeypatch):
    shutil.copytree(ROOT / "experiments", tmp_path / "experiments")
    monkeypatch.chdir(tmp_path)
    names = {}
    for program in console.programs(page.read_text("utf-8")):
        exec(program, names)


@pytest.mark.long
def test_the_reference_of_commands_is_what_their_help_says():
    page = make_cli.PAGE.read_text("utf-8")
    assert make_cli.page(page) == page, "run: python docs/make_cli.py"


def test_every_help_has_an_example_that_names_its_command():
    for words in make_cli.commands():
        text = " ".join(make_cli.help_text(words).split())
        if "COMMAND [ARGS]" not in text:
            assert f"Example: {' '.join(words)} " in text, words


def prose(page):
    """A page's text without its blocks of code."""
    return re.sub(r"```.*?```", "", page.read_text("utf-8"), flags=re.DOTALL)


def anchors(page):
    """What links may name of a page: its headings, in the spelling of addresses."""
    headings = re.findall(r"^#+ (.*)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_links_lead_somewhere(page):
    for target, anchor in re.findall(r"\]\(([^)#\s]*)#?([^)\s]*)\)", prose(page)):
        if "://" not in target:
            file = page.parent / target if target else page
            assert file.exists(), target
            assert not anchor or anchor in anchors(file), f"{target}#{anchor}"


def test_the_index_leads_to_every_page():
    index = (ROOT / "docs/README.md").read_text("utf-8")
    decisions = (ROOT / "docs/decisions/README.md").read_text("utf-8")
    for page in PAGES[1:]:
        if page.parent.name == "decisions":
            assert page.name == "README.md" or f"({page.name})" in decisions, page
        elif page.name != "README.md":
            assert f"({os.path.relpath(page, ROOT / 'docs')})" in index, page


@pytest.mark.system
@pytest.mark.release  # each link: above
def test_the_site_has_every_page_and_needs_no_network(tmp_path):
    sphinx = [sys.executable, "-m", "sphinx", "-W", "-q", "-c", ROOT / "docs/site", ROOT, tmp_path]
    done = subprocess.run(sphinx, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    searched = (tmp_path / "searchindex.js").read_text("utf-8")
    for page in PAGES:
        name = page.relative_to(ROOT).with_suffix("")
        assert f'"{name}"' in searched
        built = (tmp_path / f"{name}.html").read_text("utf-8")
        assert not re.findall(r'<(?:script|img)[^>]* src="\w+:|<link[^>]* href="\w+:', built), name


@pytest.mark.long
@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("tetractl re", {"replay"}),
        ("tetractl stats --form", {"--format"}),
        ("tetractl run --plant ", {"sim", "lab"}),
        ("tetractl lab em", {"emulate"}),
    ],
)
def test_completion_knows_commands_options_and_choices(typed, offered):
    assert offered <= set(_completion("complete_bash", typed).split())


@pytest.mark.long
def test_completion_is_installed_into_the_users_shell(tmp_path):
    home = {
        "HOME": str(tmp_path),
        "SHELL": "/bin/bash",
        "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1",
    }
    done = subprocess.run(
        [TETRACTL, "--install-completion", "bash"],
        env=os.environ | home,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "tetractl" in (tmp_path / ".bashrc").read_text("utf-8")


def _completion(instruction, typed):
    words = {"COMP_WORDS": typed, "COMP_CWORD": str(typed.count(" "))}
    done = subprocess.run(
        [TETRACTL],
        env=os.environ | words | {"_TETRACTL_COMPLETE": instruction},
        capture_output=True,
        text=True,
    )
    assert "Traceback" not in done.stderr
    return done.stdout

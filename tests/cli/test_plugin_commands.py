"""Tests of commands from other packages: the one in docs/how-to/extend.md, and broken ones."""

import re
import sys

import pytest
from testkit import cli
from testkit.packages import install
from testkit.paths import ROOT

from tetractl.core.registries import COMMANDS, LAB_COMMANDS
from tetractl.core.registry import Registry

pytestmark = pytest.mark.system

PAGE = (ROOT / "docs" / "how-to" / "extend.md").read_text(encoding="utf-8")
FURTHEST = re.search(r"title=furthest.py\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)[1]
MODULES = {
    "furthest": FURTHEST,
    "crashing": """
def crash(): return {}["key"]
""",
    "asking": """
import typer
def ask(): typer.confirm("Continue?", abort=True)
""",
    "unimported": "import nowhere_to_be_found",
    "untyped": "def odd(value: int | str): pass",
}
POINTS = """
[tetractl.commands]
furthest = furthest:furthest
crash = crashing:crash
stats = crashing:crash
absent = unimported:f
odd = untyped:odd
[tetractl.lab_commands]
ask = asking:ask
"""


@pytest.fixture
def tetractl(tmp_path, monkeypatch):
    site = install(tmp_path / "site", "mine", "1.0", POINTS, **MODULES)
    monkeypatch.syspath_prepend(site)
    for registry in (COMMANDS, LAB_COMMANDS):
        fresh = Registry(registry.group, {})
        fresh.kinds()  # reads what is installed, and by which packages
        for read_once in ("_installed", "_packages"):
            monkeypatch.setitem(vars(registry), read_once, vars(fresh)[read_once])
    for name in MODULES:
        monkeypatch.delitem(sys.modules, name, raising=False)
    return lambda *words: cli.tetractl(tmp_path, *words, env={"COLUMNS": "100"})


def on_one_line(text):
    return " ".join(text.split())


def test_the_command_of_the_page_runs_and_its_options_have_placeholders(tetractl, folder):
    log = folder / "logs" / "trial-000.mcap"
    printed = tetractl("furthest", log).ok().stdout
    assert re.fullmatch(rf"{log}: (one|two), \d+\.\d\d mm\n", printed)
    assert tetractl("furthest", folder / "logs", "--above", "1e6").ok().stdout == ""
    words = on_one_line(tetractl("furthest", "--help").ok().stdout)
    assert re.search(
        r"LOG\|FOLDER\.\.\. (<.+> )?Trial logs: files, folders or glob patterns. \[required\]",
        words,
    )
    assert "--above D [x>=0] Only robots further away than this. [default: 0.0]" in words
    refused = tetractl("furthest", log, "--above", "x").stderr
    assert refused.startswith("error: Invalid value for '--above'")


def test_commands_that_cannot_be_used_say_why_and_break_no_other(tetractl):
    listed = on_one_line(tetractl("--help").ok().stdout.replace("│", " "))
    why = "Cannot be used: mine 1.0: the command"
    assert f"absent {why} 'absent' cannot be used: ModuleNotFoundError: No module" in listed
    assert f"odd {why} 'odd' cannot be used: AssertionError: Typer currently" in listed
    assert "furthest Print which robot of each trial ended furthest" in listed
    done = tetractl("absent", "x", "--y")
    error, hint = done.stderr.splitlines()
    assert done.returncode == 2
    assert error.startswith("error: mine 1.0: the command 'absent' cannot be used: ")
    assert "'absent = unimported:f of tetractl.commands'" in hint
    assert tetractl("schema").returncode == 0
    assert "did you mean 'furthest'?" in tetractl("furthes").stderr.lower()

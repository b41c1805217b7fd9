"""Tests that the options of all commands follow one rule, stated in docs/decisions/program.md."""

import json
import os
from importlib.util import find_spec

import pytest
import typer.main
from testkit.running import QUICK
from testkit.studies import tetractl

from tetractl.cli.app import app

pytestmark = pytest.mark.slow


def commands(command=None, words=()):
    """Yield every command with its words."""
    command = command or typer.main.get_command(app)
    names = getattr(command, "commands", ())
    if not names:
        yield words, command
    for name in list(names):
        yield from commands(command.get_command(None, name), (*words, name))


WITHOUT_JSON = ["init", "schema", "plot", "play", "replay", "export", "open", "report"]
WITHOUT_JSON += ["study", "warm", "lab stop", "lab calibrate", "lab survey", "lab rehearse"]
WITHOUT_JSON += ["lab markers", "lab bundle", "export-rosbag", "rosbag-tables"]
"""Commands that write files, play, or give what has no form but its own."""


def test_options_of_one_meaning_have_one_name():
    all_options = set()
    for words, command in commands():
        options = {option for p in command.params for option in p.opts if option.startswith("-")}
        all_options |= options
        assert ("--out" in options) == ("-o" in options), words
        assert "--json" in options or " ".join(words) in WITHOUT_JSON, words
        takes_spec = any(p.name in ("spec", "specs") for p in command.params)
        takes_spec |= words == ("rerun",)  # of the spec that its log holds
        takes_spec |= words == ("kinds",)  # of the section that is checked
        takes_spec |= words == ("lab", "guard")  # of the guard's limits
        assert ("--set" in options) == takes_spec, words
    assert {"--out", "--json", "--set", "--yes"} <= all_options
    assert "--output" not in all_options


@pytest.mark.parametrize("words", [(), ("lab",)])
def test_without_a_command_the_help_is_printed_and_no_error(tmp_path, words):
    done = tetractl(*words, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (2, "")
    assert "Usage:" in done.stdout


LOG_COMMANDS = ["replay", "plot", "info", "recover", "verify", "stats", "rerun"]
LOG_COMMANDS += ["open", "report", "lab guard"]
SPEC_COMMANDS = ["validate", "run", "lab check", "lab stop", "lab calibrate"]
if find_spec("tetractl_emulator"):
    SPEC_COMMANDS.append("lab emulate")


@pytest.mark.parametrize("command", LOG_COMMANDS + SPEC_COMMANDS)
@pytest.mark.parametrize("kind", ["missing", "fifo"])
def test_a_file_that_is_missing_or_no_regular_one_is_bad_usage(tmp_path, command, kind):
    """Regression: a FIFO hung its reader, and `replay missing.mcap` ended with 1."""
    if kind == "fifo":
        os.mkfifo(tmp_path / "x")
    done = tetractl(*command.split(), "x", cwd=tmp_path)
    assert done.returncode == 2
    said = done.stderr + done.stdout  # validate's problems are its results
    assert said.startswith(("error: x: ", "x: ")), said
    assert said.count("\n") == 1
    assert ("not a regular file" in said) == (kind == "fifo")


def test_json_is_format_json_and_a_folder_of_one_log_is_that_log(tmp_path):
    (tmp_path / "spec.yaml").write_text(QUICK)
    done = tetractl("run", "spec.yaml", "--trials", "1", "-o", "logs", "--json", cwd=tmp_path).ok()
    for words in (("stats", "logs", "--json"), ("stats", "logs", "--format", "json")):
        assert tetractl(*words, cwd=tmp_path).stdout == done.stdout
    info = json.loads(tetractl("info", "logs", "--json", cwd=tmp_path).stdout)
    assert info["log"] == "logs/trial-000.mcap"

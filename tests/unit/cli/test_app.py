"""Tests of how errors become lines and exit codes, and of commands that cannot be used."""

import errno
from types import SimpleNamespace

import pytest
import typer

from tetractl.cli import app as module
from tetractl.cli.app import (
    _Group,
    _print_version,
    _report_error,
    _suggest_equals_sign,
    print_error,
    run_app,
)
from tetractl.core.errors import AbortError, Exit, LogError, TetractlError, UsageError
from tetractl.core.registries import COMMANDS, LAB_COMMANDS
from tetractl.core.registry import PluginError
from tetractl.tools.plugin_fault import PluginTrialError


def caused(error, cause):
    error.__cause__ = cause
    return error


def during(error, context):
    error.__context__ = context
    return error


MISSING = FileNotFoundError(errno.ENOENT, "No such file", "spec.yaml")
CASES = {
    "a usage error": (UsageError("wrong", "do it so"), 2, ["error: wrong", "hint: do it so"]),
    "a failure": (TetractlError("failed"), 1, ["error: failed"]),
    "an abort": (AbortError("a fault"), 1, ["error: a fault"]),
    "a log": (LogError("a\nb", "c\nd"), 1, ["error: a", "b", "hint: c", "d"]),
    "no such module": (
        ModuleNotFoundError("x", name="pandas.core"),
        2,
        [
            "error: this command needs pandas, which is not installed",
            "hint: install it in your copy of the tetractl repository with: pip install "
            "'.[dataframe]'",
        ],
    ),
    "a module of Unix": (
        ModuleNotFoundError("x", name="termios"),
        2,
        [
            "error: this command does not run on Windows, because Python has no module 'termios' "
            "there",
            "hint: simulations, tables and reports run on Windows",
        ],
    ),
    "no such file": (MISSING, 2, ["error: spec.yaml: there is no such file or folder"]),
    "a full disk": (OSError(errno.ENOSPC, "No space left", "a.csv"), 1, ["error: a.csv: No space "
                                                                        "left"]),
    "an error without a file": (OSError(errno.EIO, "Input/output error"), 1, [
        "error: Input/output error"]),
    "an error without words": (OSError("odd"), 1, ["error: odd"]),
    "Ctrl-C": (KeyboardInterrupt(), 130, ["error: interrupted"]),
    "an abort of typer": (typer.Abort(), 130, ["error: interrupted"]),
    "an end of a file": (caused(typer.Abort(), EOFError("it ends")), 1, ["error: EOFError: it "
                                                                        "ends"]),
    "a reader that ended": (BrokenPipeError(), 0, []),
    "a reader of rich that ended": (during(SystemExit(), BrokenPipeError()), 0, []),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_an_error_of_the_user_has_its_lines_and_its_exit_code(case, capsys):
    error, code, lines = CASES[case]
    assert _report_error(error) == code
    assert capsys.readouterr().err.splitlines() == lines


@pytest.mark.parametrize(
    "error",
    [
        ZeroDivisionError(),
        ValueError("x"),
        SystemExit(3),
        ModuleNotFoundError("x", name="tetractl.gone"),
        ModuleNotFoundError("x"),
    ],
)
def test_a_defect_of_the_program_is_not_called_an_error_of_the_user(error, capsys):
    assert _report_error(error) is None
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("dev_mode", [False, True])
def test_the_traceback_of_a_plug_in_is_shown_in_development(monkeypatch, capsys, dev_mode):
    monkeypatch.setattr(module.sys, "flags", SimpleNamespace(dev_mode=dev_mode))
    code = _report_error(PluginTrialError("a fault", "a hint"))
    assert code == (None if dev_mode else Exit.FAILED)
    assert bool(capsys.readouterr().err) != dev_mode
    assert _report_error(UsageError("x")) == Exit.USAGE


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["run", "s.yaml", "--set", "a.b", "3"], "write --set a.b=3"),
        (["run", "--set", "a=1", "--set", "b", "2", "x"], "write --set b=2"),
        (["run", "--set", "a=1", "x"], None),
        (["run", "--set", "a"], None),
        (["run", "--sets", "a", "3"], None),
    ],
)
def test_a_setting_without_an_equals_sign_is_written_as_it_should_be(monkeypatch, words, hint):
    monkeypatch.setattr(module.sys, "argv", ["tetractl", *words])
    assert _suggest_equals_sign() == hint


def test_a_complaint_is_an_error_and_a_hint_if_there_is_one(capsys):
    assert print_error(Exit.USAGE, "a", "b") == Exit.USAGE
    assert capsys.readouterr().err == "error: a\nhint: b\n"
    assert print_error(Exit.FAILED, "a") == Exit.FAILED
    assert capsys.readouterr().err == "error: a\n"


def run(monkeypatch, *words):
    monkeypatch.setattr(module.sys, "argv", ["tetractl", *words])
    return run_app()


def test_an_empty_argument_is_refused_before_anything_runs(monkeypatch, capsys):
    assert run(monkeypatch, "run", "") == Exit.USAGE
    said = capsys.readouterr().err.splitlines()
    assert said[0] == "error: an argument of the command is empty"


def test_the_version_is_printed_and_nothing_else(monkeypatch, capsys):
    assert run(monkeypatch, "--version") == Exit.DONE
    assert capsys.readouterr().out.startswith("tetractl ")
    assert _print_version(False) is None


def test_a_wrong_option_is_a_line_with_the_help(monkeypatch, capsys):
    assert run(monkeypatch, "validate", "--nonsense") == Exit.USAGE
    error, hint = capsys.readouterr().err.splitlines()
    assert error.startswith("error: No such option: --nonsense")
    assert hint.startswith("hint: try '")
    assert hint.endswith("tetractl validate --help'")
    assert run(monkeypatch, "nonsense") == Exit.USAGE
    assert capsys.readouterr().err.startswith("error: No such command 'nonsense'")


def test_the_exit_code_of_a_command_is_that_of_the_program(monkeypatch):
    for code, expected in ((3, 3), (None, 0), (Exit.FAILED, 1)):
        monkeypatch.setattr(module, "app", lambda standalone_mode, code=code: code)
        assert run(monkeypatch, "run") == expected

    def fail(standalone_mode):
        raise ZeroDivisionError

    monkeypatch.setattr(module, "app", fail)
    with pytest.raises(ZeroDivisionError):
        run(monkeypatch, "run")


CONTEXT = SimpleNamespace(command_path="tetractl")


@pytest.mark.parametrize(("name", "registry"), [(None, COMMANDS), ("lab", LAB_COMMANDS)])
def test_a_command_is_made_when_it_is_asked_for(name, registry):
    group = _Group(name=name)
    names = registry.names()
    assert set(names) <= set(group.commands)
    assert group.commands[names[0]] is None
    command = group.get_command(CONTEXT, names[0])
    assert command.name == names[0]
    assert group.get_command(CONTEXT, names[0]) is command
    assert group.get_command(CONTEXT, "nonsense") is None


def test_a_command_of_a_package_that_is_not_installed_names_the_package(monkeypatch):
    monkeypatch.setattr(COMMANDS, "_installed", {})
    group = _Group(name=None)
    with pytest.raises(UsageError, match="'tetractl identify' needs tetractl-identify") as caught:
        group.get_command(CONTEXT, "identify")
    assert "pip install" in caught.value.hint


def test_commands_are_in_the_order_of_the_help_and_those_of_other_packages_follow():
    names = list(_Group(name=None).commands)
    known = [name for name in names if name in module.PANEL_BY_COMMAND]
    assert known == [name for name in module.PANEL_BY_COMMAND if name in names]
    assert names[: len(known)] == known


def test_a_broken_command_of_another_package_tells_why(monkeypatch):
    error = PluginError("odd 1: the command 'odd' cannot be used: it fails")

    def load(name):
        raise error

    monkeypatch.setattr(COMMANDS, "load", load)
    command = module._load_command(COMMANDS, "odd")
    assert "Cannot be used: odd 1" in command.help
    with pytest.raises(PluginError, match="it fails"):
        command.main(["--any", "word"], standalone_mode=False)


def test_what_is_no_function_is_an_error_of_its_package(monkeypatch):
    monkeypatch.setattr(COMMANDS, "load", lambda name: 5)
    monkeypatch.setattr(
        COMMANDS,
        "create_unusable_error",
        lambda name, why: PluginError(f"{name} cannot be used: {why}"),
    )
    assert "Cannot be used: odd cannot" in module._load_command(COMMANDS, "odd").help
    with pytest.raises(TypeError, match="callable"):
        module._load_command(COMMANDS, "run")  # one of our own is a defect

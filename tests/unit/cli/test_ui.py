"""Tests of what commands share: output files that may be written, warnings, and consent."""

import io

import pytest

from tetractl.cli import ui
from tetractl.core.errors import UsageError
from tetractl.log.read.trial_log import Damage


def test_an_output_file_must_be_new_and_its_folder_must_exist(tmp_path):
    ui.refuse_existing(None)
    ui.refuse_existing(tmp_path / "new.yaml")
    (tmp_path / "old.yaml").touch()
    for wrong, says in (
        (tmp_path / "old.yaml", "exists already"),
        (tmp_path, "exists already"),
        (tmp_path / "none" / "new.yaml", "does not exist"),
        (tmp_path / "old.yaml" / "new.yaml", "does not exist"),
    ):
        with pytest.raises(UsageError, match=says):
            ui.refuse_existing(wrong)


def test_an_output_folder_must_be_empty_or_new(tmp_path):
    ui.refuse_filled(None)
    ui.refuse_filled(tmp_path / "new")
    ui.refuse_filled(tmp_path)
    (tmp_path / "file").touch()
    for filled in (tmp_path, tmp_path / "file"):
        with pytest.raises(UsageError, match="exists already"):
            ui.refuse_filled(filled)


def test_a_file_that_is_replaced_must_not_be_a_folder(tmp_path):
    (tmp_path / "old.svg").touch()
    ui.require_folder_of(tmp_path / "old.svg")
    ui.require_folder_of(tmp_path / "new.svg")
    with pytest.raises(UsageError, match="this is a folder, but a file is needed"):
        ui.require_folder_of(tmp_path)


@pytest.mark.parametrize(
    ("yes", "terminal", "is_allowed"),
    [(True, False, True), (False, True, True), (True, True, True), (False, False, False)],
)
def test_robots_move_only_with_yes_or_a_terminal(monkeypatch, yes, terminal, is_allowed):
    monkeypatch.setattr(ui, "has_keys", lambda: terminal)
    if is_allowed:
        ui.require_yes_or_terminal(yes)
        return
    with pytest.raises(UsageError, match="no terminal to ask for permission"):
        ui.require_yes_or_terminal(yes)
    with pytest.raises(UsageError, match="no terminal to ask for permission"):
        ui.require_consent(yes, "Robots move.")


def test_a_person_is_asked_unless_yes_is_given(monkeypatch):
    questions = []
    monkeypatch.setattr(ui, "has_keys", lambda: True)
    monkeypatch.setattr(ui.typer, "confirm", lambda text, **options: questions.append(text))
    ui.require_consent(True, "Robots move.")
    assert questions == []
    ui.require_consent(False, "Robots move.")
    assert questions == ["Robots move. Continue?"]


@pytest.mark.parametrize("count", [0, 1, 2])
@pytest.mark.parametrize("strict", [False, True])
def test_warnings_are_errors_only_if_there_are_any_and_only_with_strict(
    monkeypatch, capsys, count, strict
):
    warnings = tuple(f"doubt {i}" for i in range(count))
    monkeypatch.setattr("tetractl.run.plausibility.find_warnings", lambda loaded: warnings)
    if strict and count:
        words = "a warning" if count == 1 else f"{count} warnings"
        with pytest.raises(UsageError, match=f"the spec has {words}, and with --strict"):
            ui.print_warnings(None, strict)
    else:
        assert ui.print_warnings(None, strict) == warnings
    assert capsys.readouterr().err.splitlines() == [f"warning: {text}" for text in warnings]


@pytest.mark.parametrize(
    ("quiet", "terminal", "is_told"),
    [(False, False, True), (False, True, True), (True, True, True), (True, False, False)],
)
def test_compiling_is_announced_to_a_person_even_if_quiet(
    monkeypatch, capsys, quiet, terminal, is_told
):
    monkeypatch.setattr(ui, "is_terminal", lambda stream: terminal)
    ui.announce_compiling(quiet, "compiling")
    assert capsys.readouterr().err == ("compiling\n" if is_told else "")


def test_the_damage_of_a_log_is_told_on_stderr(capsys):
    ui.warn_of_damage("a.mcap", None)
    assert capsys.readouterr().err == ""
    ui.warn_of_damage("a.mcap", Damage(("torn",), ("all after 2 s",)))
    assert capsys.readouterr().err == "damaged: a.mcap: torn\nlost: a.mcap: all after 2 s\n"


def test_what_is_told_is_safe_for_a_terminal(monkeypatch):
    stream = io.StringIO()
    monkeypatch.setattr(ui.sys, "stderr", stream)
    ui.print_messages("a\x1b[2J", "b")
    assert stream.getvalue() == "a\\x1b[2J\nb\n"


def test_results_are_tables_or_json(capsys):
    ui.print_results(True, {"a": 1}, [])
    assert capsys.readouterr().out.strip() == '{\n  "a": 1\n}'

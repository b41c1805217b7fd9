"""Tests of which tables `export` writes where, and of its exit code."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from tetractl.cli import export as module
from tetractl.cli.export import _table_paths, export
from tetractl.core.errors import Exit, LogError, UsageError
from tetractl.log.read.trial_log import Damage
from tetractl.statistics.trial_tables import TABLES
from tetractl.tools.table.table import Column, Table


def test_a_folder_holds_all_tables_or_one(tmp_path):
    out = tmp_path / "new"
    assert _table_paths(out, None) == {name: out / f"{name}.csv" for name in TABLES}
    assert _table_paths(out, "steps") == {"steps": out / "steps.csv"}
    assert not out.exists()


@pytest.mark.parametrize("name", ["a.csv", "a.CSV", "new/a.csv"])
def test_a_file_holds_one_table(tmp_path, name):
    assert _table_paths(tmp_path / name, "steps") == {"steps": tmp_path / name}
    with pytest.raises(UsageError, match="a single file can hold only one table"):
        _table_paths(tmp_path / name, None)


def test_a_folder_whose_name_ends_like_a_table_is_a_folder(tmp_path):
    (tmp_path / "a.csv").mkdir()
    paths = _table_paths(tmp_path / "a.csv", "steps")
    assert paths == {"steps": tmp_path / "a.csv" / "steps.csv"}


@pytest.mark.parametrize("inner", ["", "inner", "inner/more"])
def test_a_file_is_no_folder(tmp_path, inner):
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="file: this is not a folder"):
        _table_paths(tmp_path / "file" / inner, None)


def test_an_unknown_table_lists_those_that_there_are(tmp_path):
    with pytest.raises(UsageError, match="there is no table named 'step'") as caught:
        _table_paths(tmp_path, "step")
    assert caught.value.hint == f"the tables are {', '.join(TABLES)}"


@pytest.fixture
def logs(monkeypatch, tmp_path):
    """Let logs be read: each by its damage, or an error."""

    def given(**contents):
        paths = [Path(f"{name}.mcap") for name in contents]
        monkeypatch.setattr(module, "find_logs", lambda logs: paths)

        def of_log(path, wanted):
            content = contents[path.stem]
            if isinstance(content, Exception):
                raise content
            table = Table("", (Column("log", [path.stem]),))
            return dict.fromkeys(wanted, table), content

        monkeypatch.setattr("tetractl.statistics.trial_tables.read_tables", of_log)
        return SimpleNamespace(
            run=lambda: export(["x"], tmp_path / "steps.csv", "steps"),
            text=lambda: (tmp_path / "steps.csv").read_text(),
        )

    return given


def test_the_rows_of_all_logs_are_in_one_file(logs, capsys):
    both = logs(a=None, b=None)
    assert both.run() == Exit.DONE
    assert both.text() == "log\na\nb\n"
    assert capsys.readouterr().out.endswith("steps.csv\n")


def test_a_damaged_or_unreadable_log_fails_and_the_others_are_written(logs, capsys):
    damaged = logs(a=Damage(("torn",), ()), b=None)
    assert damaged.run() == Exit.FAILED
    assert damaged.text() == "log\na\nb\n"
    assert "damaged: a.mcap: torn" in capsys.readouterr().err
    unreadable = logs(a=LogError("a.mcap: no log"), b=None)
    assert unreadable.run() == Exit.FAILED
    assert unreadable.text() == "log\nb\n"
    assert "warning: a.mcap: no log" in capsys.readouterr().err


def test_if_no_log_can_be_read_nothing_is_written(logs, tmp_path):
    none = logs(a=LogError("x"), b=LogError("y"))
    with pytest.raises(LogError, match="none of the logs can be read"):
        none.run()
    assert list(tmp_path.iterdir()) == []

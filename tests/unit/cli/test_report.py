"""Tests of `report` and `open`: where the page is written, and what cannot be read."""

from contextlib import nullcontext
from pathlib import Path

import pytest

from tetractl.cli import report as module
from tetractl.cli.report import open_, report
from tetractl.core.errors import Exit, UsageError


@pytest.fixture
def unread(monkeypatch):
    """Make a page without reading a log; returns the problems that it has."""
    problems = []
    monkeypatch.setattr(
        "tetractl.report.page.report", lambda logs, title, on_log: (f"<p>{title}</p>", problems)
    )
    monkeypatch.setattr(module.ui, "show_progress", lambda what: nullcontext())
    return problems


def test_a_page_is_written_and_named(unread, tmp_path, capsys):
    out = tmp_path / "page.html"
    assert report(["a"], out, "A title") == Exit.DONE
    assert out.read_text() == "<p>A title</p>"
    assert capsys.readouterr().out == f"{out}\n"


def test_a_log_that_cannot_be_read_fails_and_is_told(unread, tmp_path, capsys):
    unread.append("a.mcap: torn")
    assert report(["a"], tmp_path / "page.html", "") == Exit.FAILED
    assert capsys.readouterr().err == "warning: a.mcap: torn\n"


def test_a_folder_that_is_missing_is_refused(unread, tmp_path):
    with pytest.raises(UsageError, match="does not exist"):
        report(["a"], tmp_path / "none" / "page.html", "")


@pytest.mark.parametrize("has_browser", [False, True])
@pytest.mark.parametrize("named", [False, True])
def test_a_page_is_opened_in_a_browser_if_there_is_one(
    unread, tmp_path, capsys, monkeypatch, has_browser, named
):
    opened = []

    def open_in_browser(address):
        opened.append(address)
        return has_browser

    monkeypatch.setattr("tetractl.tools.children.open_in_browser", open_in_browser)
    monkeypatch.setattr(module, "mkdtemp", lambda prefix: str(tmp_path))
    out = tmp_path / "mine.html" if named else None
    assert open_(["a"], out) == Exit.DONE
    file = out or tmp_path / "report.html"
    assert opened == [file.as_uri()]
    assert file.is_file()
    assert ("no browser was found" in capsys.readouterr().err) != has_browser
    assert isinstance(file, Path)

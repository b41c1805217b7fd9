"""Tests of what `tetractl reproduce` prints, with which exit code, and which papers it runs."""

import json

import pytest
from tetractl_papers import command, trials
from tetractl_papers.claim import Claim, Fate, at_most
from tetractl_papers.paper import Paper
from tetractl_papers.registries import PAPERS

from tetractl.core.errors import Exit, UsageError


def paper(*expected):
    """A paper whose claim is met by trials whose numbers are 1, and verdicts that its page says."""
    claims = [
        Claim(f"figure {i}", "2", "one", float, at_most(2), "mm", expected=fate, why="because")
        for i, fate in enumerate(expected)
    ]
    return Paper("Somebody, 2026", {}, claims)


@pytest.fixture
def ran(monkeypatch):
    """The papers that were run, each as its folder and number of trials."""
    papers = {"right": paper(Fate.REACHED), "wrong": paper(Fate.REACHED, Fate.MISSED)}
    runs = []

    def run_arms(of_paper, folder, specs, count, run_batch, tell):
        runs.append((folder, count))
        return {"one": [1.0, 1.0, 1.0]}

    monkeypatch.setattr(trials, "run_arms", run_arms)
    monkeypatch.setattr(PAPERS, "names", lambda: list(papers))
    monkeypatch.setattr(PAPERS, "load", papers.__getitem__)
    monkeypatch.setattr(type(PAPERS), "__contains__", lambda self, name: name in papers)
    return runs


def test_without_a_paper_the_papers_are_listed_and_nothing_runs(ran, capsys):
    assert command.reproduce() is Exit.DONE
    assert capsys.readouterr().out.split() == ["right", "wrong"]
    assert ran == []


def test_without_a_paper_json_lists_them_too(ran, capsys):
    assert command.reproduce(as_json=True) is Exit.DONE
    assert json.loads(capsys.readouterr().out) == {"papers": {"right": {}, "wrong": {}}}


def test_a_paper_whose_verdicts_are_the_pages_is_done(ran, capsys, tmp_path):
    assert command.reproduce(["right"], trials=7, out=tmp_path) is Exit.DONE
    assert ran == [(tmp_path / "right", 7)]
    printed = capsys.readouterr()
    assert "Somebody, 2026" in printed.out
    assert "the page states" not in printed.err


def test_each_other_verdict_is_told_and_makes_the_command_fail(ran, capsys, tmp_path):
    assert command.reproduce(["right", "wrong"], out=tmp_path) is Exit.FAILED
    told = [line for line in capsys.readouterr().err.splitlines() if "the page states" in line]
    (line,) = told
    assert "wrong: figure 1: the result is reached, but the page states missed" in line


def test_all_papers_are_run_on_demand(ran, tmp_path):
    command.reproduce(all_papers=True, out=tmp_path)
    assert [folder.name for folder, _ in ran] == ["right", "wrong"]


def test_json_has_the_figures_and_no_table(ran, capsys, tmp_path):
    assert command.reproduce(["wrong"], out=tmp_path, as_json=True) is Exit.FAILED
    printed = json.loads(capsys.readouterr().out)
    assert list(printed["papers"]) == ["wrong"]
    described = printed["papers"]["wrong"]
    assert described["source"] == "Somebody, 2026"
    first, second = described["figures"]
    assert first["figure"] == "figure 0"
    assert first["published"] == "2"
    assert first["unit"] == "mm"
    assert (first["value"], first["n"]) == (1, 3)
    assert (first["verdict"], first["expected"]) == ("reached", "reached")
    assert (second["verdict"], second["expected"], second["why"]) == (
        "reached",
        "missed",
        "because",
    )


def test_an_unknown_paper_is_refused_before_any_runs(ran):
    with pytest.raises(UsageError, match=r"there is no paper named 'rihgt'.*right"):
        command.reproduce(["wrong", "rihgt"])
    assert ran == []

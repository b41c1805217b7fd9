"""Verdicts on published figures, and what is measured of trials."""

import numpy as np
import pytest

from tetractl.cli import reproduce as command
from tetractl.core.errors import Exit, UsageError
from tetractl.core.registries import PAPERS
from tetractl.reproduce.ou import _spinning
from tetractl.reproduce.paper import Fate, Paper, Runs, mean, share

VALUES = (10.0, 11.0, 12.0, 13.0)


@pytest.mark.parametrize(
    ("most", "page", "verdict"),
    [
        (15, Fate.REACHED, Fate.REACHED),
        (12, Fate.REACHED, Fate.MISSED),
        (12, Fate.OUT, Fate.OUT),
        (15, Fate.OUT, Fate.REACHED),
    ],
)
def test_a_figure_is_reached_by_its_whole_interval(most, page, verdict):
    found = mean("what", "published", VALUES, lambda ci: ci.high <= most, page, unit="mm")
    assert (found.ours, found.n, found.verdict) == ("11.5 mm", 4, verdict)


def test_equal_values_count_as_a_point():
    found = mean("what", "20", [11.0] * 3, lambda ci: ci.low <= 20 <= ci.high)
    assert (found.interval, found.verdict) == ("none", Fate.MISSED)


def test_a_share_above_the_published_one_is_missed():
    assert share("what", "not", [True, False], 0).verdict is Fate.MISSED
    assert share("what", "not", [False, False], 0).verdict is Fate.REACHED


def test_a_field_spins_from_a_whole_turn_on():
    time_s = np.arange(11.0)
    assert _spinning(np.linspace(0, 6.2, 11), time_s) == 0
    assert _spinning(np.linspace(0, 6.3, 11), time_s) == 10


def _figures(logs):
    errors = [log.result.total_error for log in logs["one"]]
    yield mean("error", "500 um", errors, lambda ci: ci.high <= 500, unit="um")
    yield mean("error", "0 um", errors, lambda ci: ci.high <= 0, Fate.MISSED, "noise", "um")


PAPER = Paper("Somebody, 2026", {"one": Runs("single_cell")}, _figures)


def test_a_paper_is_run_once_and_its_table_printed(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(PAPERS.builtin, "mine", f"{__name__}:PAPER")
    assert command.reproduce(["mine"], trials=3, out=tmp_path) is Exit.DONE
    logs = {path: path.stat().st_mtime_ns for path in (tmp_path / "mine/one").glob("*.mcap")}
    shown = capsys.readouterr().out
    assert "Somebody, 2026" in shown
    assert "noise" in shown
    assert command.reproduce(["mine"], trials=3, out=tmp_path) is Exit.DONE
    assert {path: path.stat().st_mtime_ns for path in logs} == logs  # none was run again
    wrong = Paper("x", PAPER.arms, lambda logs: [mean("e", "0", VALUES, lambda ci: False)])
    monkeypatch.setattr(PAPERS, "load", lambda name: wrong)
    assert command.reproduce(["mine"], trials=3, out=tmp_path) is Exit.FAILED
    assert "mine: e: missed, but reached on the page" in capsys.readouterr().err


def test_an_unknown_paper_is_refused():
    with pytest.raises(UsageError, match="there is no paper 'oo'"):
        command.reproduce(["oo"])

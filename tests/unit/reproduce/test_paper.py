"""Verdicts on published figures, and what is measured of trials."""

import json
import signal

import make_reproduce
import numpy as np
import pytest

from tetractl import api
from tetractl.cli import reproduce as command
from tetractl.core.errors import Exit, UsageError
from tetractl.core.registries import PAPERS
from tetractl.reproduce.ou_measures import _spinning
from tetractl.reproduce.paper import (
    Fate,
    Paper,
    Repeated,
    Runs,
    Work,
    at_most,
    mean,
    near,
    share,
    single,
)

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
    found = mean("what", "published", VALUES, at_most(most), page, unit="mm")
    assert (found.ours, found.n, found.verdict) == ("11.5 mm", 4, verdict)


def test_equal_values_count_as_a_point():
    found = mean("what", "20", [11.0] * 3, near(20))
    assert (found.interval, found.verdict) == ("none", Fate.MISSED)


def test_a_share_above_the_published_one_is_missed():
    assert share("what", "not", [True, False], 0).verdict is Fate.MISSED
    assert share("what", "not", [False, False], 0).verdict is Fate.REACHED


def test_a_published_mean_and_deviation_agree_within_their_own_uncertainty():
    """F = (322 / 225.1)^2 = 2.05 is below its bound 2.53 for two samples of 20."""
    values = np.random.default_rng(1).normal(0, 1, 20)
    values = 638.1 + 322.0 * (values - values.mean()) / values.std(ddof=1)
    published = Repeated(648.6, 225.1, 20)
    found = published.of_deviation("what", values, Fate.AGREES, unit="mm")
    assert (found.published, found.verdict) == ("225.1 mm (n 20: 171 to 329)", Fate.AGREES)
    assert published.of_deviation("what", 2 * values, Fate.AGREES).verdict is Fate.MISSED
    found = published.of_mean("what", values, Fate.AGREES, unit="mm")
    assert (found.published, found.verdict) == ("648.6 +- 105.4 mm (n 20)", Fate.AGREES)
    assert published.of_mean("what", values / 3, Fate.AGREES).verdict is Fate.MISSED


def test_a_published_run_agrees_if_it_is_no_rare_one_of_ours():
    runs = [float(one) for one in range(100)]
    found = single("what", 90.0, runs, Fate.AGREES, unit="mm")
    assert (found.ours, found.verdict) == ("10 of 100 runs larger", Fate.AGREES)
    assert single("what", 99.0, runs, Fate.AGREES).verdict is Fate.MISSED


def test_a_field_spins_from_a_whole_turn_on():
    time_s = np.arange(11.0)
    assert _spinning(np.linspace(0, 6.2, 11), time_s) == 0
    assert _spinning(np.linspace(0, 6.3, 11), time_s) == 10


def _figures(logs):
    errors = [log.result.total_error for log in logs["one"]]
    yield mean("error", "500 um", errors, at_most(500), unit="um")
    yield mean("error", "0 um", errors, at_most(0), Fate.MISSED, "noise", "um")


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
    wrong = Paper("x", PAPER.arms, lambda logs: [mean("e", "0", VALUES, at_most(0))])
    monkeypatch.setattr(PAPERS, "load", lambda name: wrong)
    assert command.reproduce(["mine"], trials=3, out=tmp_path) is Exit.FAILED
    assert "mine: e: missed, but reached on the page" in capsys.readouterr().err


def test_after_ctrl_c_it_goes_on_with_the_trials_it_lacks(tmp_path, monkeypatch):
    run_batch = api.run_batch

    def interrupted(*given, **named):
        return run_batch(*given, **named, on_result=lambda *_: signal.raise_signal(signal.SIGINT))

    monkeypatch.setitem(PAPERS.builtin, "mine", f"{__name__}:PAPER")
    monkeypatch.setattr(api, "run_batch", interrupted)
    with pytest.raises(KeyboardInterrupt):
        command.reproduce(["mine"], trials=3, out=tmp_path)
    done = {path: path.read_bytes() for path in (tmp_path / "mine/one").glob("*.mcap")}
    assert 1 <= len(done) < 3
    monkeypatch.setattr(api, "run_batch", run_batch)
    assert command.reproduce(["mine"], trials=3, out=tmp_path) is Exit.DONE
    assert {path: path.read_bytes() for path in done} == done


def test_what_was_computed_before_ctrl_c_is_kept(tmp_path):
    asked = []

    def once(seed, number):
        asked.append(number)
        if asked == [0, 1]:
            raise KeyboardInterrupt
        return {"found": float(seed + number)}

    work = Work(once)
    with pytest.raises(KeyboardInterrupt):
        work.results(tmp_path, 7, 3, 1)
    assert [one["found"] for one in work.results(tmp_path, 7, 3, 1)] == [7, 8, 9]
    assert asked == [0, 1, 1, 2]


def test_the_page_shows_what_the_command_printed():
    text = make_reproduce.PAGE.read_text(encoding="utf-8")
    assert make_reproduce.page(text) == text, "run: python docs/make_reproduce.py"


def test_the_page_shows_every_paper():
    stored = json.loads(make_reproduce.FOUND.read_text(encoding="utf-8"))["papers"]
    assert stored.keys() >= PAPERS.builtin.keys()


def test_an_unknown_paper_is_refused():
    with pytest.raises(UsageError, match="there is no paper 'oo'"):
        command.reproduce(["oo"])

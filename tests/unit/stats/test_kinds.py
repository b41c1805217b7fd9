"""A statistic of one's own is one function and one line, and is in every output."""

import csv
import io

import numpy as np
import pytest
from rich.console import Console
from support.batches import batch

from tetractl.stats.export import as_csv, as_json
from tetractl.stats.kinds import STATISTICS
from tetractl.stats.latex import as_latex
from tetractl.stats.statistic import number
from tetractl.stats.summary import summarise
from tetractl.stats.table import as_markdown, print_table

ERRORS = np.random.default_rng(4).gamma(4, 50, (20, 3)).tolist()
WORST = number("worst_error", "error of the worst robot", lambda result: max(result.robot_errors))


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(STATISTICS.builtin, "worst_error", f"{__name__}:WORST")


def test_it_is_in_every_table():
    summary, out = summarise(batch(ERRORS)), io.StringIO()
    print_table(summary, Console(file=out))
    mean = np.max(ERRORS, axis=1).mean()
    for text in (out.getvalue(), as_markdown(summary), as_latex(summary)):
        (line,) = [line for line in text.splitlines() if "error of the worst robot, mean" in line]
        assert f"{mean:.1f} (95" in line


def test_it_is_in_json_and_csv():
    summary = summarise(batch(ERRORS))
    found = as_json(summary)
    assert found["worst_error"]["mean"] == pytest.approx(np.max(ERRORS, axis=1).mean())
    assert found["worst_error"]["n"] == 20
    assert found["trials"][3]["worst_error"] == max(ERRORS[3])
    rows = list(csv.DictReader(io.StringIO(as_csv(summary))))
    assert [float(row["worst_error"]) for row in rows] == [max(errors) for errors in ERRORS]

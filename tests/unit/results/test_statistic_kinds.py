"""A statistic of one's own is one function and one line, and is in every output."""

import csv
import io
import re

import numpy as np
import pytest
from support.batches import batch, group

from tetractl.core.registries import STATISTICS
from tetractl.core.table.table_files import csv_text
from tetractl.core.table.terminal_table import TEXTS, print_tables
from tetractl.results.as_json import comparison_items
from tetractl.results.contrast import contrast
from tetractl.results.statistic import number
from tetractl.results.tables import data_table, tables

ERRORS = np.random.default_rng(4).gamma(4, 50, (20, 3)).tolist()
WORST = number("worst_error", "error of the worst robot", lambda result: max(result.robot_errors))


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    monkeypatch.setitem(STATISTICS.builtin, "worst_error", f"{__name__}:WORST")


def test_it_is_in_every_table(capsys):
    shown = tables(contrast([group(batch(ERRORS))]))
    print_tables(shown)
    mean = np.max(ERRORS, axis=1).mean()
    for text in (capsys.readouterr().out, *(write(shown) for write in TEXTS.values())):
        assert re.search(rf"error of the worst robot, mean\W(.*\W)?{mean:.1f} \(95", text)


def test_it_is_in_json_and_csv():
    described = contrast([group(batch(ERRORS))])
    found = comparison_items(described)
    assert found["worst_error"]["mean"] == pytest.approx(np.max(ERRORS, axis=1).mean())
    assert found["worst_error"]["n"] == 20
    assert found["trials"][3]["worst_error"] == max(ERRORS[3])
    rows = list(csv.DictReader(io.StringIO(csv_text(data_table(described)))))
    assert [float(row["worst_error"]) for row in rows] == [max(errors) for errors in ERRORS]

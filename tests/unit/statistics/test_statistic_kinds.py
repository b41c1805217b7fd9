"""Tests that a user's own statistic, one function and one line, is in every output."""

import csv
import io
import re

import numpy as np
import pytest
from testkit.batches import batch, group

from tetractl.core.registries import STATISTICS
from tetractl.statistics.as_json import comparison_items, data_table
from tetractl.statistics.describe import contrast
from tetractl.statistics.statistic import number
from tetractl.statistics.tables import tables
from tetractl.tools.table.table_files import format_csv
from tetractl.tools.table.terminal_table import TEXT_FORMATS, print_tables

ERRORS = np.random.default_rng(4).gamma(4, 50, (20, 3)).tolist()  # of three robots [mm]
MEAN_OF_WORST = np.max(ERRORS, axis=1).mean()
WORST = number("worst_error", "error of the worst robot", lambda result: max(result.robot_errors))


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    monkeypatch.setitem(STATISTICS.builtin, "worst_error", f"{__name__}:WORST")


@pytest.fixture
def comparison():
    """The comparison of one batch with nothing."""
    described = group(batch(ERRORS))
    return contrast([described])


ROW = rf"error of the worst robot, mean\W(.*\W)?{MEAN_OF_WORST:.1f} \(95"


@pytest.mark.parametrize("text_format", TEXT_FORMATS)
def test_it_is_in_every_text(comparison, text_format):
    write = TEXT_FORMATS[text_format]
    assert re.search(ROW, write(tables(comparison)))


def test_it_is_in_json(comparison):
    items = comparison_items(comparison)
    assert items["worst_error"]["mean"] == pytest.approx(MEAN_OF_WORST)
    assert items["worst_error"]["n"] == 20
    assert items["trials"][3]["worst_error"] == max(ERRORS[3])


def test_it_is_in_csv(comparison):
    text = format_csv(data_table(comparison))
    rows = list(csv.DictReader(io.StringIO(text)))
    assert [float(row["worst_error"]) for row in rows] == [max(errors) for errors in ERRORS]


def test_it_is_printed(comparison, capsys):
    print_tables(tables(comparison))
    assert re.search(ROW, capsys.readouterr().out)

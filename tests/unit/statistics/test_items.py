"""Tests of the keys of JSON and the columns of CSV, which users' scripts rely on."""

import csv
import io
import json
import math

import numpy as np
import pytest
from testkit.batches import DISTURBED, REFERENCE, batch, experiment, group, result, trial

from tetractl.core.plan import Outcome
from tetractl.statistics.as_json import comparison_items, data_table
from tetractl.statistics.describe import contrast
from tetractl.statistics.open_batch import Damaged
from tetractl.tools.table.table_files import format_csv, format_json

ERRORS = np.random.default_rng(4).gamma(4, 50, (20, 3)).tolist()

SPEC = experiment(reference=REFERENCE, plant=DISTURBED)


def as_json(described):
    """The items of one batch as a script reads them."""
    items = comparison_items(contrast([described]))
    return json.loads(format_json(items))


def test_json_holds_every_key_scripts_rely_on():
    items = as_json(group(batch(ERRORS, SPEC)))
    figures = {"mean", "std", "median", "min", "max", "ci95"}
    assert figures <= set(items["total_error"])
    assert all(figures <= set(robot) for robot in items["robots"])
    assert {"n", "mean", "std", "difference", "ci95", "p_value"} <= set(items["reference"])
    assert set(items["solve_ms"]) == {"p50", "p99", "max"}
    error = {"log", "seed", "total_error", "robot_errors"}
    ending = {"steps", "duration_s", "outcome", "entered_obstacle", "recovered"}
    assert error | ending <= set(items["trials"][0])
    assert items["trials"][0]["total_error"] == pytest.approx(sum(ERRORS[0]))


def test_json_says_what_a_usual_batch_is():
    items = as_json(group(batch(ERRORS, SPEC)))
    assert items["n_trials"] == 20
    assert items["n_counted"] == 20
    assert items["unit"] == "mm"
    assert [robot["name"] for robot in items["robots"]] == ["green", "blue", "red"]
    assert items["origin"] == "disturbed simulation"
    assert items["kind"] == "simulated"
    assert items["disturbed"] is True
    assert items["arrived"] is None
    assert items["outcomes"]["sequence completed"] == 20
    assert not items["reference"]["comparable"]
    for count in ("obstacle_violations", "aborted", "deadline_misses", "n_attempts"):
        assert items[count] == 0
    assert items["attempts"] == []
    assert items["flagged"] == []


def test_json_without_a_reference_or_enough_trials_says_null():
    items = as_json(group(batch(ERRORS[:1])))
    assert items["reference"] is None
    assert items["total_error"]["std"] is None
    assert items["total_error"]["ci95"] is None
    assert items["total_error"]["ci95_reason"] == "a single value has no spread"


def batch_with_attempt():
    """Two trials, and an aborted attempt at one."""
    aborted = result([1, 2, 3], outcome=Outcome.ABORTED)
    attempt = trial("x.attempt-1.mcap", experiment(), aborted)
    return group([*batch(ERRORS[:2]), attempt])


def test_attempts_are_items_of_json_that_are_not_counted_as_trials():
    items = as_json(batch_with_attempt())
    assert items["n_trials"] == 2
    assert items["n_attempts"] == 1
    assert items["attempts"][0]["outcome"] == "aborted"


def test_json_stays_json_where_nothing_is_known():
    trials = batch([[math.nan] * 3] * 2, SPEC, outcome=Outcome.ABORTED, solve_ns=())
    items = as_json(group(trials, [Damaged("torn.mcap", "no header")]))
    assert items["total_error"]["mean"] is None
    assert items["reference"]["difference"] is None
    assert items["solve_ms"] == {"p50": None, "p99": None, "max": None}
    assert items["trials"][0]["robot_errors"] == [None] * 3
    assert items["damaged"] == [{"log": "torn.mcap", "problem": "no header"}]


def as_csv(described):
    """The rows of one batch as a script reads them."""
    text = format_csv(data_table(contrast([described])))
    return list(csv.DictReader(io.StringIO(text)))


def test_attempts_are_rows_of_csv_that_say_so():
    rows = as_csv(batch_with_attempt())
    assert [row["attempt"] for row in rows] == ["false", "false", "true"]
    assert [row["counted"] for row in rows] == ["true", "true", "false"]
    assert {row["origin"] for row in rows} == {"undisturbed simulation"}

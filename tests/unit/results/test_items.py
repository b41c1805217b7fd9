import csv
import io
import json
import math

import numpy as np
import pytest
from support.batches import DISTURBED, REFERENCE, SCALE, batch, experiment, group, result, trial

from tetractl.core.plan import Outcome
from tetractl.core.table.table_files import csv_text, json_text
from tetractl.results.as_json import comparison_items
from tetractl.results.contrast import contrast
from tetractl.results.open_batch import Damaged
from tetractl.results.tables import data_table

ERRORS = np.random.default_rng(4).gamma(4, 50, (20, 3)).tolist()
SPEC_PLAIN = experiment()
SPEC = experiment(reference=REFERENCE, scale=SCALE, plant=DISTURBED)


def as_json(*groups):
    return json.loads(json_text(comparison_items(contrast(groups))))


def rows_of(*groups):
    return list(csv.DictReader(io.StringIO(csv_text(data_table(contrast(groups))))))


def test_json_holds_every_key_scripts_rely_on():
    found = as_json(group(batch(ERRORS, SPEC)))
    assert (found["n_trials"], found["n_counted"], found["unit"]) == (20, 20, "mm")
    figures = {"mean", "std", "median", "min", "max", "ci95"}
    assert figures <= set(found["total_error"])
    assert [robot["name"] for robot in found["robots"]] == ["green", "blue", "red"]
    assert all(figures <= set(robot) for robot in found["robots"])
    for count in ("obstacle_violations", "aborted", "deadline_misses", "n_attempts"):
        assert found[count] == 0
    assert (found["origin"], found["arrived"]) == ("disturbed simulation", None)
    assert found["outcomes"]["sequence completed"] == 20
    assert found["reference"]["comparable"]
    assert (found["attempts"], found["flagged"]) == ([], [])
    assert (found["kind"], found["disturbed"]) == ("simulated", True)
    assert set(found["solve_ms"]) == {"p50", "p99", "max"}
    assert {"n", "mean", "std", "difference", "ci95", "p_value"} <= set(found["reference"])
    low, high = found["total_error"]["ci95"]
    assert low < found["total_error"]["mean"] < high
    keys = {"log", "seed", "total_error", "robot_errors", "steps", "duration_s", "outcome"}
    assert keys | {"entered_obstacle", "recovered"} <= set(found["trials"][0])
    assert found["trials"][0]["total_error"] == pytest.approx(sum(ERRORS[0]))
    assert found["scaled"]["body_lengths"] == pytest.approx(found["scaled"]["mean"] / 50)


def test_json_without_a_reference_or_enough_trials_says_null():
    found = as_json(group(batch(ERRORS[:1])))
    assert found["reference"] is None
    assert found["scaled"] is None
    assert found["total_error"]["std"] is None
    assert found["total_error"]["ci95"] is None
    assert found["total_error"]["ci95_reason"] == "one value has no spread"


def test_json_stays_json_where_nothing_is_known():
    trials = batch([[math.nan] * 3] * 2, SPEC, outcome=Outcome.ABORTED, solve_ns=())
    found = as_json(group(trials, [Damaged("torn.mcap", "no header")]))
    assert found["total_error"]["mean"] is None
    assert found["reference"]["difference"] is None
    assert found["solve_ms"] == {"p50": None, "p99": None, "max": None}
    assert found["trials"][0]["robot_errors"] == [None] * 3
    assert found["damaged"] == [{"log": "torn.mcap", "problem": "no header"}]


def test_attempts_are_rows_that_say_so():
    trials = batch(ERRORS[:2])
    aborted = result([1, 2, 3], outcome=Outcome.ABORTED)
    summary = group([*trials, trial("x.attempt-1.mcap", SPEC_PLAIN, aborted)])
    rows = rows_of(summary)
    assert [(row["attempt"], row["counted"]) for row in rows] == [
        ("false", "true"),
        ("false", "true"),
        ("true", "false"),
    ]
    assert {row["origin"] for row in rows} == {"undisturbed simulation"}
    found = as_json(summary)
    assert (found["n_trials"], found["n_attempts"]) == (2, 1)
    assert found["attempts"][0]["outcome"] == "aborted"

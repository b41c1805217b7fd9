import csv
import io
import json
import math

import numpy as np
import pytest
from support.batches import DISTURBED, REFERENCE, SCALE, batch, experiment, result, trial

from tetractl.core.plan import Outcome
from tetractl.stats.comparison import compare
from tetractl.stats.damaged import Damaged
from tetractl.stats.export import as_csv, as_json
from tetractl.stats.summary import summarise

ERRORS = np.random.default_rng(4).gamma(4, 50, (20, 3)).tolist()
SPEC_PLAIN = experiment()
SPEC = experiment(reference=REFERENCE, scale=SCALE, plant=DISTURBED)


def strict(found):
    return json.loads(json.dumps(found, allow_nan=False))


def test_json_holds_every_key_scripts_rely_on():
    found = strict(as_json(summarise(batch(ERRORS, SPEC))))
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
    assert (found["attempts"], found["to_look_at"]) == ([], [])
    assert set(found["solve_ms"]) == {"p50", "p99", "max"}
    assert {"n", "mean", "std", "difference", "ci95", "p_value"} <= set(found["reference"])
    low, high = found["total_error"]["ci95"]
    assert low < found["total_error"]["mean"] < high
    keys = {"path", "seed", "total_error", "robot_errors", "steps", "duration_s", "outcome"}
    assert keys | {"entered_obstacle", "recovered"} <= set(found["trials"][0])
    assert found["trials"][0]["total_error"] == pytest.approx(sum(ERRORS[0]))
    assert found["scaled"]["body_lengths"] == pytest.approx(found["scaled"]["mean"] / 50)


def test_json_without_a_reference_or_enough_trials_says_null():
    found = strict(as_json(summarise(batch(ERRORS[:1]))))
    assert found["reference"] is None
    assert found["scaled"] is None
    assert found["total_error"]["std"] is None
    assert found["total_error"]["ci95"] is None
    assert found["total_error"]["ci95_reason"] == "one value has no spread"


def test_json_stays_json_where_nothing_is_known():
    trials = batch([[math.nan] * 3] * 2, SPEC, outcome=Outcome.ABORTED, solve_ns=())
    found = strict(as_json(summarise(trials, [Damaged("torn.mcap", "no header")])))
    assert found["total_error"]["mean"] is None
    assert found["reference"]["difference"] is None
    assert found["solve_ms"] == {"p50": None, "p99": None, "max": None}
    assert found["trials"][0]["robot_errors"] == [None] * 3
    assert found["damaged"] == [{"path": "torn.mcap", "problem": "no header"}]


def test_json_of_a_comparison_holds_both_batches():
    comparison = compare(summarise(batch(ERRORS)), summarise(batch(ERRORS[:9])))
    found = strict(as_json(comparison.ours, comparison))
    assert found["against"]["n_counted"] == 9
    assert found["comparison"]["n"] == [20, 9]
    assert found["comparison"]["verdict"] == "undecided"
    assert found["comparison"]["paired"]["n"] == 9
    assert found["comparison"]["both"]["ci95_method"] == "both intervals"
    assert -1 <= found["comparison"]["cliffs_delta"]["value"] <= 1


def test_csv_has_a_row_a_trial_with_units_in_its_columns():
    rows = list(csv.DictReader(io.StringIO(as_csv(summarise(batch(ERRORS))))))
    assert len(rows) == 20
    assert float(rows[3]["total_error_mm"]) == pytest.approx(sum(ERRORS[3]))
    assert float(rows[3]["error_blue_mm"]) == ERRORS[3][1]
    assert rows[3]["outcome"] == "sequence completed"


def test_csv_of_a_comparison_tells_the_batches_apart():
    ours, theirs = summarise(batch(ERRORS[:2])), summarise(batch(ERRORS[:3]))
    rows = list(csv.DictReader(io.StringIO(as_csv(ours, compare(ours, theirs)))))
    assert [row["batch"] for row in rows] == ["ours"] * 2 + ["against"] * 3


def test_an_undisturbed_simulation_has_no_p_and_no_scaled_error():
    spec = experiment(reference=REFERENCE, scale=SCALE)
    found = strict(as_json(summarise(batch(ERRORS, spec))))
    reference = found["reference"]
    assert (found["origin"], reference["comparable"]) == ("undisturbed simulation", False)
    assert (reference["mean"], reference["difference"], reference["p_value"]) == (648.6, None, None)
    assert found["scaled"] is None


def test_attempts_are_rows_that_say_so():
    trials = batch(ERRORS[:2])
    aborted = result([1, 2, 3], outcome=Outcome.ABORTED)
    summary = summarise([*trials, trial("x.attempt-1.mcap", SPEC_PLAIN, aborted)])
    rows = list(csv.DictReader(io.StringIO(as_csv(summary))))
    assert [(row["attempt"], row["counted"]) for row in rows] == [
        ("False", "True"),
        ("False", "True"),
        ("True", "False"),
    ]
    assert {row["origin"] for row in rows} == {"undisturbed simulation"}
    found = strict(as_json(summary))
    assert (found["n_trials"], found["n_attempts"]) == (2, 1)
    assert found["attempts"][0]["outcome"] == "aborted"

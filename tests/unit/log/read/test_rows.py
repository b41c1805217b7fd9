import json
from dataclasses import replace

import numpy as np
import pytest
from support.studies import FAILING, SMALL, run

from tetractl.core.errors import LogError, UsageError
from tetractl.log.read.reader import read_result
from tetractl.log.read.rows import ROWS, SPEC, find_rows, read_rows
from tetractl.stats.trials import load_trials
from tetractl.study.options import Logs

ALL, FIRST, FAILED = Logs(float("inf"), True), Logs(1, False), Logs(0, True)


@pytest.fixture
def logged(tmp_path):
    """The folder of an arm of three trials, with their logs."""
    run(tmp_path, SMALL, logs=ALL)
    return tmp_path / "out" / "dead_time=0.1"


def test_a_row_gives_the_result_that_the_log_gives(logged):
    rows, problem = read_rows(logged / ROWS)
    assert (len(rows), problem) == (3, "")
    for row in rows:
        log = read_result(logged / f"trial-{row.trial:03d}.mcap")
        assert row.path == f"{logged / ROWS}:{row.trial + 1}"
        for one, other in zip(
            (row.result.verdict.final.array(), row.result.robot_errors, row.result.solve_ns),
            (log.result.verdict.final.array(), log.result.robot_errors, log.result.solve_ns),
            strict=True,
        ):
            np.testing.assert_array_equal(one, other)
        verdicts = [
            replace(each.result.verdict, final=log.result.verdict.final) for each in (row, log)
        ]
        assert replace(row.result, verdict=verdicts[0]) == replace(log.result, verdict=verdicts[1])
        known = ("experiment", "seed", "trial", "origin", "warnings", "recovered", "simulated")
        assert [getattr(row, name) for name in known[1:]] == [
            getattr(log, name) for name in known[1:]
        ]
        assert row.experiment.model_dump(exclude={"trials"}) == log.experiment.model_dump(
            exclude={"trials"}
        )


def test_the_later_of_two_lines_counts_and_a_torn_one_is_no_row(logged):
    path = logged / ROWS
    lines = path.read_text().splitlines()
    again = json.loads(lines[1])
    again["result"]["steps"] = "6"
    path.write_text("\n".join([*lines, json.dumps(again), lines[0][:100]]))
    rows, problem = read_rows(path)
    assert [row.result.steps == 6 for row in rows] == [False, True, False]
    assert problem == ""


@pytest.mark.parametrize(
    "spoil",
    [
        lambda row: row.pop("result"),
        lambda row: row.pop("trial"),
        lambda row: row["result"].update(total_error="1e300"),
        lambda row: row["result"].update(robot_errors="[1, 2, 3, 4]"),
        lambda row: row["timing"].update(solve_ns="x"),
        lambda row: row.update(result=[1]),
    ],
)
def test_rows_that_hold_no_result_are_counted(logged, spoil):
    path = logged / ROWS
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    spoil(rows[1])
    path.write_text("".join(json.dumps(row) + "\n" for row in rows) + "[1]\nnone\n")
    found, problem = read_rows(path)
    assert [row.trial for row in found] == [0, 2]
    assert problem.startswith("3 of 5 rows hold no result")


def test_a_file_without_its_spec_is_an_error(logged):
    (logged / SPEC).unlink()
    with pytest.raises(LogError, match=r"spec\.resolved\.yaml: cannot be read"):
        read_rows(logged / ROWS)
    trials, damaged = load_trials([logged], rows=True)
    assert len(trials) == 3  # by their logs
    assert [one.path for one in damaged] == [str(logged / ROWS)]


def test_trials_with_a_log_are_read_from_it_and_the_others_from_their_rows(tmp_path):
    ran = run(tmp_path, SMALL, logs=FIRST)
    arm = tmp_path / "out" / "dead_time=0"
    assert find_rows(tmp_path / "out") == [arm / ROWS, tmp_path / "out" / "dead_time=0.1" / ROWS]
    trials, damaged = load_trials([arm], rows=True)
    assert [trial.path for trial in trials] == [
        str(arm / "trial-000.mcap"), f"{arm / ROWS}:2", f"{arm / ROWS}:3"
    ]  # fmt: skip
    errors = [ran.rows[arm.name, trial].columns["total_error_mm"] for trial in range(3)]
    assert [trial.result.total_error for trial in trials] == errors
    assert not damaged
    assert len(load_trials([arm])[0]) == 1
    (arm / "trial-000.mcap").write_bytes(b"")  # what a full disk left of it
    trials, damaged = load_trials([arm], rows=True)
    assert [trial.result.total_error for trial in trials] == errors
    assert [one.path for one in damaged] == [str(arm / "trial-000.mcap")]


def test_a_trial_that_failed_is_counted_once(tmp_path):
    run(tmp_path, FAILING, logs=FAILED)
    (arm,) = {path.parent for path in (tmp_path / "out").rglob("trial-*.mcap")}
    trials, damaged = load_trials([arm], rows=True)
    assert not damaged
    assert sorted(trial.trial for trial in trials) == [0, 1, 2, 3]
    assert all(trial.path.endswith(".mcap") for trial in trials)


def test_a_folder_without_logs_is_refused_where_rows_are_not_asked_for(tmp_path):
    run(tmp_path, SMALL)
    with pytest.raises(UsageError, match="no logs"):
        load_trials([tmp_path / "out" / "dead_time=0"])
    assert find_rows(tmp_path / "study.yaml") == []

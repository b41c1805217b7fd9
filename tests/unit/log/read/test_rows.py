import json
from dataclasses import replace

import numpy as np
import pytest
from support.studies import SMALL, run

from tetractl.core.errors import LogError
from tetractl.log.read.find import ROWS
from tetractl.log.read.reader import read_result
from tetractl.log.read.rows import SPEC, row_results
from tetractl.study.options import Logs


@pytest.fixture
def arm(tmp_path):
    """The folder of an arm of three trials, with their logs."""
    run(tmp_path, SMALL, logs=Logs(float("inf"), True))
    return tmp_path / "out" / "dead_time=0.1"


def lines(arm):
    return [json.loads(line) for line in (arm / ROWS).read_text().splitlines()]


def rewrite(arm, rows):
    (arm / ROWS).write_text("".join(json.dumps(row) + "\n" for row in rows))


def test_a_row_gives_the_result_that_the_log_gives(arm):
    rows = row_results(arm / ROWS)
    assert list(rows) == [0, 1, 2]
    for trial, row in rows.items():
        log = read_result(arm / f"trial-{trial:03d}.mcap")
        assert row.path == f"{arm / ROWS}:{trial + 1}"
        final = log.result.verdict.final
        np.testing.assert_array_equal(row.result.verdict.final.array(), final.array())
        verdict = replace(row.result.verdict, final=final)
        assert replace(row.result, verdict=verdict) == log.result
        for name in ("seed", "trial", "origin", "warnings", "recovered"):
            assert getattr(row, name) == getattr(log, name)
        one, other = (of.experiment.model_dump(exclude={"trials"}) for of in (row, log))
        assert one == other


def test_the_later_of_two_lines_counts_and_a_torn_one_is_no_row(arm):
    rows = lines(arm)
    before = rows[1]["result"]["steps"]
    again = json.loads(json.dumps(rows[1]))
    again["result"]["steps"] = str(int(before) - 1)
    older = {key: value for key, value in rows[0].items() if key not in ("result", "timing")}
    rewrite(arm, [older, *rows, again])
    with (arm / ROWS).open("a") as file:
        file.write(json.dumps(older)[:100])
    found = row_results(arm / ROWS)
    assert [str(found[trial].result.steps) == before for trial in range(3)] == [True, False, True]


@pytest.mark.parametrize(
    "spoil",
    [
        lambda row: row.pop("result"),
        lambda row: row.pop("timing"),
        lambda row: row["result"].update(total_error="1e300"),
        lambda row: row["result"].update(robot_errors="[1, 2, 3, 4]"),
        lambda row: row["result"].update(unit="furlong"),
        lambda row: row["result"].update(reason=5),
        lambda row: row["result"].update(final_x=f"[{10**400}]"),
        lambda row: row["timing"].update(solve_ns="x"),
        lambda row: row["timing"].update(solve_ns="[Infinity]"),
        lambda row: row.update(result=[1]),
        lambda row: row.update(result=None),
    ],
)
def test_a_row_may_hold_no_result(arm, spoil):
    rows = lines(arm)
    spoil(rows[1])
    rewrite(arm, rows)
    found = row_results(arm / ROWS)
    assert [trial for trial, row in found.items() if row is None] == [1]


NO_ROWS = [
    *("", "none", "[1]", "5", '{"trial": 0}', "[" * 100_000),
    '{"trial": -1, "arm_hash": "x"}',
    '{"trial": true, "arm_hash": "x"}',
    '{"trial": Infinity, "arm_hash": "x"}',
]


@pytest.mark.parametrize("line", NO_ROWS)
def test_what_is_no_row_is_passed_over(arm, line):
    text = (arm / ROWS).read_text()
    (arm / ROWS).write_text(f"{line}\n{text}{line}\n")
    assert list(row_results(arm / ROWS)) == [0, 1, 2]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (None, "there is no such file"),
        ("", r"spec\.resolved\.yaml"),
        (lambda text: text.replace("seed: 7", "seed: 8"), "is not of the spec in"),
    ],
)
def test_rows_need_their_spec(arm, text, problem):
    spec = arm / SPEC
    whole = spec.read_text()
    spec.unlink()
    if text is not None:
        spec.write_text(text if isinstance(text, str) else text(whole))
        assert spec.read_text() != whole
    with pytest.raises(LogError, match=problem):
        row_results(arm / ROWS)

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from support.studies import SMALL, run

from tetractl.core.errors import LogError
from tetractl.log.format.channels import RESOLVED_SPEC
from tetractl.log.read.find import ROWS
from tetractl.log.read.reader import read_result
from tetractl.results.open_batch import Batch
from tetractl.results.trial_tables import trials_table
from tetractl.run import rows as run_rows
from tetractl.run.rows import cut_to_lines, row_results
from tetractl.study.options import Logs


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    run(folder, SMALL, logs=Logs(float("inf"), True))
    return folder / "out" / "dead_time=0.1"


@pytest.fixture
def arm(finished, tmp_path):
    """The folder of an arm of three trials, with their logs."""
    return shutil.copytree(finished, tmp_path / "arm")


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
    again["result"]["steps"] = before - 1
    older = {key: value for key, value in rows[0].items() if key != "result"}
    rewrite(arm, [older, *rows, again])
    with (arm / ROWS).open("a") as file:
        file.write(json.dumps(older)[:100])
    found = row_results(arm / ROWS)
    assert [found[trial].result.steps == before for trial in range(3)] == [True, False, True]


HOSTILE = [
    *(None, True, -1, 0.5, 1e400, float("nan"), 10**30, 2**60, "", "x", "\x1b[2J", "9" * 5000),
    *([], [1], {}, {"a": 1}, {"trial": 0}, [[[]]]),
]


FINE = [
    *((name, value) for name in ("code", "processor") for value in ("", "x")),
    *((name, 0.5) for name in ("wall_s", "cpu_s")),
    ("logged", True),
    *(("solve_ns", value) for value in ([], [1])),
    ("warnings", None),
]


@pytest.mark.parametrize("name", ["warnings", *run_rows._Line.model_fields])
def test_a_value_that_tetractl_does_not_write_spoils_its_row_alone(arm, name):
    """Each value is checked once, here: whatever is in a row can be computed with and shown."""
    rows = lines(arm)
    for value in HOSTILE:
        spoiled = json.loads(json.dumps(rows[1]))
        (spoiled["result"] if name == "warnings" else spoiled)[name] = value
        (arm / ROWS).write_text("\n".join([*map(json.dumps, (rows[0], spoiled, rows[2])), ""]))
        try:
            found = row_results(arm / ROWS)
        except LogError as error:  # another hash than that of the spec
            assert (name, type(value)) == ("arm_hash", str), error
            continue
        assert found[0] and found[2]
        if found.get(1) is not None:
            assert (name, value) in FINE
            trials_table(Batch.of([found[1]]))


@pytest.mark.parametrize(
    "spoil",
    [
        lambda row: row["result"].update(total_error=1e300),
        lambda row: row["result"].update(robot_errors=[1, 2, 3, 4]),
        lambda row: row["result"].update(unit="furlong"),
        lambda row: row["result"].update(reason=5),
        lambda row: row["result"].update(warnings=-1),
        lambda row: row["result"].update(final_x=[10**400]),
        lambda row: row["result"].update(final_x=[[]]),
        lambda row: row.update(solve_ns="x"),
        lambda row: row.update(solve_ns=[float("inf")]),
    ],
)
def test_a_row_may_hold_no_result(arm, spoil):
    rows = lines(arm)
    spoil(rows[1])
    rewrite(arm, rows)
    found = row_results(arm / ROWS)
    assert [trial for trial, row in found.items() if row is None] == [1]


NO_ROWS = [
    *("", "none", "[1]", "5", "{}", "[" * 100_000, '{"trial": ' * 100_000, "1" * 5000),
    *(f'{{"trial": {value}}}' for value in ("-1", "true", "Infinity", '"0"', "[0]", "1.0")),
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
        (lambda text: text.replace("seed: 7", "seed: 8"), "belongs to another spec than"),
    ],
)
def test_rows_need_their_spec(arm, text, problem):
    spec = arm / RESOLVED_SPEC
    whole = spec.read_text()
    spec.unlink()
    if text is not None:
        spec.write_text(text if isinstance(text, str) else text(whole))
        assert spec.read_text() != whole
    with pytest.raises(LogError, match=problem):
        row_results(arm / ROWS)


def test_rows_that_cannot_be_cut_are_said_to_be_not_writable(arm, monkeypatch):
    def refuse(path, mode="r"):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(run_rows.Path, "open", refuse)
    with pytest.raises(LogError, match=f"{ROWS}: cannot be written: Read-only file system"):
        cut_to_lines(arm / ROWS)

"""Tests of `tetractl export`: other programs read its tables."""

from pathlib import Path

import pytest
from testkit.cli import tetractl

from tetractl.log.read.reader import read_trial

pytestmark = pytest.mark.slow


def test_tables_hold_what_the_logs_hold(folder):
    import pandas  # slow to import

    done = tetractl(folder, "export", "logs", "-o", "csv")
    names = ("trials", "steps", "poses", "estimates", "events")
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [f"csv/{name}.csv" for name in names]
    tables = {name: pandas.read_csv(folder / "csv" / f"{name}.csv") for name in names}
    logs = [read_trial(path) for path in sorted((folder / "logs").glob("*.mcap"))]
    assert all(list(table.columns[:2]) == ["log", "trial"] for table in tables.values())
    assert len(tables["trials"]) == 2
    assert len(tables["steps"]) == sum(len(log.steps) for log in logs)
    assert len(tables["poses"]) == sum(2 * len(log.frames) for log in logs)
    assert len(tables["events"]) == sum(len(log.events) for log in logs)
    for log in logs:
        assert log.result is not None
        steps = tables["steps"].query(f"log == '{Path(log.log).relative_to(folder)}'")
        assert steps["k"].tolist() == [step.k for step in log.steps]
        poses = tables["poses"].query(f"trial == {log.start.trial} and robot == 'two'")
        assert poses["x_mm"].tolist() == pytest.approx(log.mocap[:, 1, 0].tolist(), rel=1e-15)
        row = tables["trials"].query(f"trial == {log.start.trial}").iloc[0]
        assert row["total_error_mm"] == log.result.total_error


def test_a_log_that_cannot_be_read_is_named_and_the_rest_written(folder, tmp_path):
    import pandas  # slow to import

    (tmp_path / "a.mcap").write_bytes((folder / "logs" / "trial-000.mcap").read_bytes())
    (tmp_path / "b.mcap").write_bytes(b"nothing")
    done = tetractl(tmp_path, "export", "a.mcap", "b.mcap", "-o", "out")
    assert done.returncode == 1
    assert done.stderr.startswith("warning: b.mcap: ")
    assert len(done.stderr.splitlines()) == 1
    assert len(pandas.read_csv(tmp_path / "out" / "trials.csv")) == 1


@pytest.mark.parametrize(
    ("command", "out"),
    [("export", "\x1b[1mout"), pytest.param("report", "r.html", marks=pytest.mark.long)],
)
def test_a_damaged_log_is_told_and_a_failure(folder, tmp_path, command, out):
    """Regression: both were silent, with exit code 0. Paths are printed without raw escapes."""
    data = bytearray((folder / "logs" / "trial-000.mcap").read_bytes())
    del data[-2000:]
    log = tmp_path / "a\x1b[31m.mcap"
    log.write_bytes(data)
    done = tetractl(tmp_path, command, log, "-o", out)
    assert done.returncode == 1
    assert "damaged" in done.stderr
    assert "\\x1b[31m.mcap" in done.stderr
    assert "\x1b" not in done.stdout + done.stderr


@pytest.mark.long
def test_logs_of_different_experiments_are_exported_apart(folder, tmp_path):
    (tmp_path / "other.yaml").write_text(
        (folder / "quick.yaml").read_text().replace("name: two", "name: three")
    )
    assert tetractl(tmp_path, "run", "other.yaml", "--out", "logs", "--quiet").returncode == 0
    done = tetractl(tmp_path, "export", folder / "logs", "logs", "-o", "out")
    assert done.returncode == 2
    assert "the columns of the table trials differ" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_a_full_disk_is_one_clear_line_and_leaves_no_table(folder, tmp_path):
    (tmp_path / "steps.csv.part").symlink_to("/dev/full")
    logs = folder / "logs"
    done = tetractl(tmp_path, "export", logs, "-o", "steps.csv", "--table", "steps")
    assert done.returncode == 1
    assert ".csv.part: the table cannot be written: No space left" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "steps.csv").exists()

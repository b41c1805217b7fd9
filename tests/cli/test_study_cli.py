"""Tests that `tetractl study` gives the same table, however it is run."""

import csv
import signal

import pytest
from testkit.studies import FAILING, Running, logs, results, tetractl, write

from tetractl import run_study
from tetractl.log.read.reader import read_result

pytestmark = pytest.mark.slow


def study(*args, cwd):
    return tetractl("study", *args, cwd=cwd)


def table(out):
    with (out / "trials.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def finished_study(tmp_path_factory):
    """The quick study, run in one go."""
    folder = tmp_path_factory.mktemp("whole")
    write(folder)
    done = study("study.yaml", "--out", "out", "--jobs", 1, cwd=folder).ok()
    return folder, done


@pytest.mark.long
def test_a_study_leaves_a_folder_an_arm_a_table_and_figures(finished_study):
    folder, _ = finished_study
    out = folder / "out"
    arms = sorted(path.name for path in out.iterdir() if path.is_dir())
    assert len(arms) == 8
    assert "few-dead_time=0.1-a=3" in arms
    assert {path.name for path in out.iterdir() if path.is_file()} == {
        "trials.csv", "error-arms.png", "error-plant.dead_time.png",
        "error-robots.r.a.png",
    }  # fmt: skip


@pytest.mark.system
def test_a_study_is_checked_previewed_and_run_from_python_alike(
    finished_study, tmp_path, monkeypatch
):
    folder, _ = finished_study
    write(tmp_path)
    assert "study.yaml: ok: study" in tetractl("validate", "study.yaml", cwd=tmp_path).ok().stdout
    dry = study("study.yaml", "--out", "again", "--dry-run", cwd=tmp_path).ok().stdout
    assert "40 of 40 trials to again" in dry
    assert "few-dead_time=0.1-a=3" in dry and not (tmp_path / "again").exists()
    monkeypatch.chdir(tmp_path)
    batches = run_study("study.yaml", "again")
    assert [len(batch.trials) for batch in batches.values()] == [5] * 8
    totals = [row["total_error_mm"] for row in table(folder / "out")]
    assert [row["total_error_mm"] for row in table(tmp_path / "again")] == totals


@pytest.mark.long
def test_a_study_killed_and_run_again_gives_the_same_table(finished_study, tmp_path):
    write(tmp_path)
    out = tmp_path / "out"
    for already in (5, 20):
        with Running(tmp_path, "study.yaml", "--out", "out", "--jobs", 2) as running:
            running.until_logs(out, already)
            running.process.send_signal(signal.SIGKILL)
            running.process.wait()
        assert logs(out) < 40
        assert not (out / "trials.csv").exists()
    torn = next(out.glob("*/trial-*.mcap"))
    torn.write_bytes(torn.read_bytes()[:-20])  # as a power cut may leave it
    done = study("study.yaml", "--out", "out", "--jobs", 2, cwd=tmp_path).ok()
    assert "40 of 40 to run" not in done.stderr
    assert results(out) == results(finished_study[0] / "out")


@pytest.mark.long
def test_a_failed_trial_is_told_and_does_not_stop_the_others(tmp_path):
    write(tmp_path, FAILING)
    args = ("--out", "out", "--jobs", 1)
    done = study("study.yaml", *args, cwd=tmp_path)
    assert done.returncode == 1
    assert "failed: speed=1e+308/0: aborted: the cost is not finite" in done.stderr
    assert "4 trials aborted" in done.stderr
    rows = table(tmp_path / "out")
    assert [row["outcome"] == "aborted" for row in rows] == [True] * 4 + [False] * 4
    results = [read_result(tmp_path / "out" / row["log"]) for row in rows]
    assert [result.digest for result in results] == [row["content_digest"] for row in rows]

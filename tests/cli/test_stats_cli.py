"""Tests of `tetractl stats`: tables in every format, and remarks about wrong logs."""

import csv
import io
import json
import os
import shutil
import subprocess
from dataclasses import replace

import pytest
from testkit import cli, random_trials
from testkit.running import TETRACTL, first_of

pytestmark = pytest.mark.slow

REFERENCE = {"source": "section V", "n": 20, "mean": 648.6, "std": 225.1}

PLANT = {"type": "sim", "heading_noise": 0.05}


def stats(*args, cwd):
    return cli.tetractl(cwd, "stats", *args)


def write(folder, count, first=0, **fields):
    """Logs of trials whose total errors are 300, 310, ... mm."""
    folder.mkdir(exist_ok=True)
    fields = {"reference": REFERENCE, "plant": PLANT} | fields
    for i in range(first, first + count):
        trial = random_trials.trial(i + 1, index=i, steps=3, frames=2, **fields)
        errors = (100.0, 100.0, 100.0 + 10 * i)
        result = replace(trial.result, robot_errors=errors, total_error=sum(errors))
        random_trials.write(replace(trial, result=result), folder / f"trial-{i:03d}.mcap")
    return folder


@pytest.fixture(scope="module")
def ten(tmp_path_factory):
    return write(tmp_path_factory.mktemp("batch") / "ten", 10)


@pytest.fixture
def work(tmp_path, ten):
    shutil.copytree(ten, tmp_path / "ten")
    return tmp_path


def rows_of(table):
    """The words of each line, by the name in its first column."""
    lines = table.splitlines()
    return {line.partition("  ")[0].strip(): line.split() for line in lines}


def csv_rows(text):
    return list(csv.DictReader(io.StringIO(text)))


def test_the_table_shows_the_batch_beside_the_published_result(work):
    done = stats("ten", cwd=work)
    assert (done.returncode, done.stderr) == (0, "")
    assert "10 of 10 trials valid" in done.stdout
    assert "\x1b" not in done.stdout
    rows = rows_of(done.stdout)
    # of 300, 310 ... 390: n, mean, standard deviation, median, least, greatest
    assert rows["total"][1:7] == ["10", "345.0", "30.3", "345.0", "300.0", "390.0"]
    assert rows["published"][1:4] == ["20", "648.6", "225.1"]
    assert "robot 2" not in rows
    rows = rows_of(stats("ten", "--full", cwd=work).stdout)
    assert rows["robot 2"][2:4] == ["10", "145.0"]


def test_csv_markdown_and_latex(work):
    rows = csv_rows(stats("ten", "--format", "csv", cwd=work).stdout)
    assert [float(row["total_error_mm"]) for row in rows] == [300 + 10 * i for i in range(10)]
    assert "| total | 10 | 345.0 |" in stats("ten", "--format", "markdown", cwd=work).stdout
    assert r"total & 10 & 345.0 &" in stats("ten", "--format", "latex", cwd=work).stdout


def test_a_torn_log_is_flagged_and_the_rest_printed(work):
    torn = work / "ten/trial-004.mcap"
    torn.write_bytes(torn.read_bytes()[:-2000])
    (work / "ten/trial-011.mcap").write_bytes(b"not a log at all")
    done = stats("ten", "--format", "json", cwd=work)
    document = json.loads(done.stdout)
    assert done.returncode == 1
    assert "ten/trial-004.mcap is damaged" in done.stderr
    assert "damaged: ten/trial-011.mcap: this is not an MCAP file" in done.stderr
    assert document["n_trials"] == 10
    assert document["recovered"] == 1
    assert [trial["log"] for trial in document["trials"] if trial["recovered"]] == [
        "ten/trial-004.mcap"
    ]
    assert document["damaged"] == [
        {"log": "ten/trial-011.mcap", "problem": "this is not an MCAP file"}
    ]


@pytest.fixture
def three(work):
    """A folder with the ten trials; twelve that differ in the controller, with equal errors; and
    nine in a world without disturbances."""
    write(work / "exact", 12, controller={"motion": "exact"})
    write(work / "still", 9, plant={"type": "sim"})
    return work


@pytest.mark.long
def test_several_folders_are_batches_compared_two_by_two(three):
    document = json.loads(stats("ten", "exact", "still", "--json", cwd=three).stdout)
    assert [arm["name"] for arm in document["groups"]] == ["ten", "exact", "still"]
    assert [arm["n_counted"] for arm in document["groups"]] == [10, 12, 9]
    controllers, plants, both = document["comparisons"]
    assert (controllers["one"], controllers["other"]) == ("ten", "exact")
    assert controllers["pairs"] == 10
    assert (controllers["difference"], controllers["verdict"]) == (0.0, None)
    assert controllers["detects_sd"] == pytest.approx(1.0, abs=0.01)
    assert not plants["comparable"] and not both["comparable"]
    assert (plants["rank_p"], plants["verdict"]) == (None, None)


@pytest.mark.long
def test_comparisons_are_printed_and_drawn(three):
    done = stats("ten", "exact", "still", "--plot", "ecdf.svg", cwd=three)
    assert (done.returncode, done.stderr) == (0, "wrote ecdf.svg\n")
    assert "Final total errors of 3 batches" in done.stdout
    assert done.stdout.count("none: the plants differ") == 2
    assert (three / "ecdf.svg").stat().st_size > 1000


@pytest.mark.long
@pytest.mark.parametrize("form", first_of(["table", "json", "csv"]))
def test_a_reader_that_goes_away_is_no_reason_to_complain(work, form):
    command = f"{TETRACTL} stats ten --format {form} | true"
    env = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    done = subprocess.run(
        ["bash", "-c", command], cwd=work, env=env, capture_output=True, text=True
    )
    assert (done.stdout, done.stderr) == ("", "")

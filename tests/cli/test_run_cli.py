"""Tests of `tetractl run`: its files, its output, and its end when it is stopped."""

import math
import os
import resource
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from testkit import cli
from testkit.paths import SPECS
from testkit.running import (
    ENDLESS,
    HEAVY,
    PATIENCE_S,
    QUICK,
    Running,
    assert_interrupted,
    environment,
    first_of,
)
from testkit.studies import tetractl

from tetractl.log.read.reader import content_digest, read_result, read_trial
from tetractl.spec.load import load_spec

pytestmark = pytest.mark.slow

EXPERIMENTS = [path for path in SPECS if "type: lab" not in path.read_text()]
EXPERIMENTS.sort(key=lambda path: path.stem != "three_m3pi")
ELSEWHERE = (  # a faster test runs them, or their like
    "magnetospirillum_hold",  # holds: test_route_measure.py
    "microjet_hold",
    "tetrahymena_hold",
    "three_m3pi_lab",  # in the emulated lab: its plays
    "three_m3pi_paper_lab",
    "tetrahymena_lab",
    "tetrahymena_dish",
)


def run(*args, cwd, **options):
    return tetractl("run", *args, cwd=cwd, **options)


def digests(folder):
    return {path.name: read_result(path).digest for path in sorted(folder.glob("*.mcap"))}


@pytest.fixture(scope="module")
def batch(tmp_path_factory):
    """The quick batch of three trials, run once; what it printed."""
    folder = tmp_path_factory.mktemp("batch")
    (folder / "quick.yaml").write_text(QUICK)
    done = run("quick.yaml", "--out", "logs", "--json", cwd=folder).ok()
    return folder, done


@pytest.fixture
def work(tmp_path, batch):
    """A folder of one's own with the spec and its logs."""
    shutil.copytree(batch[0], tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.mark.long
@pytest.mark.parametrize(
    "path",
    first_of(EXPERIMENTS, also=[path for path in EXPERIMENTS if path.stem not in ELSEWHERE]),
    ids=lambda path: path.stem,
)
def test_every_shipped_experiment_brings_its_robots_near_their_targets(path, tmp_path):
    experiment = load_spec(path).experiment
    circle_radii = np.zeros_like(experiment.setup.a)
    trials = 1
    settings = []
    if experiment.hold is not None:
        # cells that stay at their targets circle there: where one trial ends is chance
        circle_radii = experiment.setup.speed / experiment.setup.a
        trials = 4
        settings = ["--set", "hold.time=10"]  # s: long enough for many turns of the circle
    words = ["--trials", trials, "--plant", "sim", "--out", "logs", "--quiet", *settings]
    run(path, *words, cwd=tmp_path).ok()
    results = [read_result(tmp_path / "logs" / f"trial-00{i}.mcap") for i in range(trials)]
    assert all(result.outcome.complete and not result.recovered for result in results)
    errors = np.mean([result.result.robot_errors for result in results], axis=0)
    for i, robot in enumerate(results[0].experiment.robots):
        way = math.dist(robot.start, robot.target)
        assert errors[i] < max(0.15 * way, 2 * circle_radii[i]), robot.name


def test_a_run_writes_a_log_a_trial_and_says_where(batch):
    folder, done = batch
    assert sorted(path.name for path in (folder / "logs").iterdir()) == [
        f"trial-00{i}.mcap" for i in range(3)
    ]
    lines = [line for line in done.stderr.splitlines() if not line.startswith("compiling")]
    assert [line.split(":")[0] for line in lines[:3]] == [f"trial {i} of 3" for i in (1, 2, 3)]
    assert lines[3:] == [
        "logs are in logs; this command prints all figures: tetractl stats logs --full",
        "look at one of them with: tetractl replay logs/trial-000.mcap",
    ]
    assert "\x1b" not in done.stderr + done.stdout
    for i in range(3):
        log = read_trial(folder / "logs" / f"trial-00{i}.mcap")
        assert (log.start.trial, log.start.seed, log.damage) == (i, 7, None)
        assert log.start.spec_text == QUICK


@pytest.mark.long
def test_the_same_spec_and_seed_give_the_same_logs_whatever_the_jobs(batch, tmp_path):
    folder, _ = batch
    run(folder / "quick.yaml", "--jobs", 2, "--out", "two", cwd=tmp_path).ok()
    first = digests(folder / "logs")
    assert digests(tmp_path / "two") == first
    assert len(set(first.values())) == 3
    for name, digest in first.items():
        assert content_digest(tmp_path / "two" / name) == digest


def test_a_dry_run_writes_nothing_and_prints_a_spec(batch, tmp_path):
    folder, _ = batch
    spec = folder / "quick.yaml"
    done = run(spec, "--dry-run", "--trials", 2, "--set", "robots.r.a=5", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert list(tmp_path.iterdir()) == []
    assert "# Trials to run: 2 of 2" in done.stdout
    assert "#   control steps of a trial: at most 7" in done.stdout
    assert "trial-000.mcap ... logs/quick-" in done.stdout
    (tmp_path / "kept.yaml").write_text(done.stdout)
    assert tetractl("validate", "kept.yaml", cwd=tmp_path).returncode == 0
    again = run("kept.yaml", "--dry-run", cwd=tmp_path)
    first_lines = done.stdout.splitlines()
    lines = again.stdout.splitlines()
    assert lines[1:-1] == first_lines[1:-1]  # but for the name and the hour


def test_a_dry_run_refuses_what_a_run_would(work):
    args = ["quick.yaml", "--set", "robots.0.target=[-1, 0]", "--out", "new"]
    dry, wet = (run(*args, *more, cwd=work) for more in (["--dry-run"], []))
    assert dry.returncode == wet.returncode == 2
    assert "outside the arena" in dry.stderr
    assert dry.stderr == wet.stderr
    assert not (work / "new").exists()


def test_resuming_runs_what_is_missing_and_sets_the_unfinished_aside(work):
    logs = work / "logs"
    before = digests(logs)
    (logs / "trial-001.mcap").unlink()
    (logs / "trial-002.mcap").rename(logs / "trial-002.mcap.part")
    written_ns = (logs / "trial-000.mcap").stat().st_mtime_ns
    refused = run("quick.yaml", "--out", "logs", cwd=work)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "logs: this folder holds logs already" in refused.stderr
    dry = run("quick.yaml", "--out", "logs", "--resume", "--dry-run", cwd=work)
    assert "# Trials to run: 2 of 3" in dry.stdout
    done = run("quick.yaml", "--out", "logs", "--resume", cwd=work).ok()
    assert digests(logs) == before
    assert (logs / "trial-000.mcap").stat().st_mtime_ns == written_ns
    assert (logs / "trial-002.attempt-1.mcap.part").exists()
    assert "3 of 3 trials valid" in done.stdout


@pytest.mark.system
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_second_interruption_does_not_wait_for_the_plan(tmp_path, jobs):
    """Two different signals, since two of one kind may arrive as one; the plan takes minutes."""
    with Running(tmp_path, HEAVY, "--jobs", str(jobs)) as running:
        running.until_logging(jobs)
        running.process.send_signal(signal.SIGINT)
        running.process.send_signal(signal.SIGTERM)
        assert running.end() == 130
        assert_interrupted(running, jobs, "a second interruption stopped the trial at once")


@pytest.mark.system
@pytest.mark.parametrize("everyone", [True, False], ids=["group", "parent"])
def test_one_interruption_ends_trials_in_several_processes(tmp_path, everyone):
    with Running(tmp_path, ENDLESS, "--jobs", "2") as running:
        running.until_logging(2, size=30_000)
        send = os.killpg if everyone else os.kill
        send(running.process.pid, signal.SIGINT)
        assert running.end() == 130
        assert_interrupted(running, 2, "interrupted; the control step was finished first")


@pytest.mark.long
@pytest.mark.parametrize("limit", [4096, 30_000])
def test_a_full_disk_aborts_the_trial_and_says_so_once(batch, tmp_path, limit):
    def full():
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    # Python 3.11 keeps bytecode that such a limit cut short, and the next process fails on it
    unwritten = {"PYTHONDONTWRITEBYTECODE": "1"}
    words = ("run", batch[0] / "quick.yaml", "--out", "logs")
    done = cli.process(tmp_path, *words, env=unwritten, preexec_fn=full)
    assert done.returncode == 1
    line = "error: trial 1: logs/trial-000.mcap: cannot write the log: File too large"
    errors = [said for said in done.stderr.splitlines() if said.startswith("error: ")]
    assert errors == [line]
    assert "logs are in logs" in done.stderr
    part = tmp_path / "logs" / "trial-000.mcap.part"
    assert part.stat().st_size == limit
    if limit > 4096:
        log = read_trial(part)
        assert log.damage is not None
        assert [step.k for step in log.steps] == list(range(len(log.steps)))


@pytest.mark.long
@pytest.mark.parametrize("args", first_of([["run", "--help"], ["--help"], ["--version"]]))
def test_help_imports_nothing_heavy(tmp_path, args):
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "tetractl", *args],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 0
    imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert "tetractl.cli.app" in imported
    heavy = {"numpy", "numba", "matplotlib", "scipy", "mcap", "google.protobuf", "pydantic"}
    if args[0] == "run":
        heavy.remove("pydantic")  # typer's own, to read a command's options
    assert heavy & imported == set()


def test_a_dry_run_sends_a_terminal_nothing_that_it_obeys(batch, tmp_path):
    """Regression: a description turned the writing direction of the operator's terminal."""
    text = (batch[0] / "quick.yaml").read_text("utf-8") + 'description: "three \\u202e robots"\n'
    (tmp_path / "turned.yaml").write_text(text, encoding="utf-8")
    done = run("turned.yaml", "--dry-run", cwd=tmp_path).ok()
    assert all(line.isprintable() for line in done.stdout.splitlines())
    assert "u202" in done.stdout.lower()


@pytest.mark.system
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs Linux's /proc")
def test_a_signal_to_all_while_processes_start_is_an_interruption_too(tmp_path):
    """Regression: it met workers that had not prepared for it, and the pool broke."""
    with Running(tmp_path, ENDLESS, "--jobs", "2") as running:
        running.until(lambda: len(running.workers()) == 2)
        os.killpg(running.process.pid, signal.SIGINT)
        assert running.end() == 130
        assert_interrupted(running, 2)

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support import cli
from support.paths import ROOT
from support.running import (
    ENDLESS,
    HEAVY,
    PATIENCE_S,
    QUICK,
    Running,
    assert_interrupted,
    environment,
    first_of,
)

from tetractl.log.read.reader import content_digest, read_result, read_trial

EXPERIMENTS = [
    path
    for path in sorted((ROOT / "experiments").glob("*.yaml"))
    if "type: lab" not in path.read_text()
]
EXPERIMENTS.sort(key=lambda path: path.stem != "three_m3pi")


def tetractl(*args, cwd, env=None):
    return cli.tetractl(cwd, *args, env=env)


def run(*args, cwd, **options):
    return tetractl("run", *args, cwd=cwd, **options)


def digests(folder):
    return {path.name: read_result(path).digest for path in sorted(folder.glob("*.mcap"))}


@pytest.fixture(scope="module")
def batch(tmp_path_factory):
    """The quick batch of three trials, run once; what it printed."""
    folder = tmp_path_factory.mktemp("batch")
    (folder / "quick.yaml").write_text(QUICK)
    done = run("quick.yaml", "--out", "logs", "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder, done


@pytest.fixture
def work(tmp_path, batch):
    """A folder of one's own with the spec and its logs."""
    shutil.copytree(batch[0], tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.mark.parametrize("path", first_of(EXPERIMENTS), ids=lambda path: path.stem)
def test_every_shipped_experiment_brings_its_robots_near_their_targets(path, tmp_path):
    done = run(path, "--trials", 1, "--plant", "sim", "--out", "logs", "--quiet", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = read_result(tmp_path / "logs" / "trial-000.mcap")
    assert found.outcome.complete
    assert not found.recovered
    for robot, error in zip(found.experiment.robots, found.result.robot_errors, strict=True):
        way = sum((t - s) ** 2 for s, t in zip(robot.start, robot.target, strict=True)) ** 0.5
        assert error < 0.15 * way, robot.name


def test_a_run_writes_a_log_a_trial_and_says_where(batch):
    folder, done = batch
    assert sorted(path.name for path in (folder / "logs").iterdir()) == [
        f"trial-00{i}.mcap" for i in range(3)
    ]
    lines = [line for line in done.stderr.splitlines() if not line.startswith("compiling")]
    assert [line.split(":")[0] for line in lines[:3]] == [f"trial {i} of 3" for i in (1, 2, 3)]
    assert lines[3:] == ["logs in logs", "look at one with: tetractl replay logs/trial-000.mcap"]
    assert "\x1b" not in done.stderr + done.stdout
    for i in range(3):
        log = read_trial(folder / "logs" / f"trial-00{i}.mcap")
        assert (log.start.trial, log.start.seed, log.damage) == (i, 7, None)
        assert log.start.spec_text == QUICK


def test_json_is_what_stats_prints(batch):
    folder, done = batch
    found = json.loads(done.stdout)
    assert (found["n_trials"], found["unit"]) == (3, "mm")
    assert done.stdout == tetractl("stats", "logs", "--format", "json", cwd=folder).stdout


def test_logs_go_to_a_folder_named_after_spec_and_hour(tmp_path):
    (tmp_path / "quick.yaml").write_text(QUICK)
    done = run("quick.yaml", "--trials", 1, "--quiet", cwd=tmp_path)
    assert done.returncode == 0
    (folder,) = (tmp_path / "logs").iterdir()
    assert folder.name.startswith("quick-2")
    assert [path.name for path in folder.iterdir()] == ["trial-000.mcap"]
    assert f"logs in logs/{folder.name}" in done.stderr
    assert "1 of 1 trials complete" in done.stdout


def test_the_same_spec_and_seed_give_the_same_logs_whatever_the_jobs(batch, tmp_path):
    folder, _ = batch
    assert run(folder / "quick.yaml", "--jobs", 2, "--out", "two", cwd=tmp_path).returncode == 0
    first, second = digests(folder / "logs"), digests(tmp_path / "two")
    assert first == second
    assert len(set(first.values())) == 3
    for name, digest in first.items():
        assert content_digest(tmp_path / "two" / name) == digest
    args = ["--seed", 8, "--trials", 1]
    other = run(folder / "quick.yaml", *args, "--out", "other", cwd=tmp_path)
    assert other.returncode == 0
    assert not set(digests(tmp_path / "other").values()) & set(first.values())


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
    shown, kept = done.stdout.splitlines(), again.stdout.splitlines()
    assert shown[1:-1] == kept[1:-1]  # but for the name and the hour


def test_a_dry_run_refuses_what_a_run_would(work):
    square = "controller.first_plan={type: square, side: 10}"
    args = ["quick.yaml", "--set", square, "--out", "new"]
    dry, wet = (run(*args, *more, cwd=work) for more in (["--dry-run"], []))
    assert dry.returncode == wet.returncode == 2
    assert "controller.first_plan: robot r would leave the arena" in dry.stderr
    assert dry.stderr == wet.stderr
    assert not (work / "new").exists()


def test_resuming_runs_what_is_missing_and_sets_the_unfinished_aside(work):
    logs = work / "logs"
    before = digests(logs)
    (logs / "trial-001.mcap").unlink()
    (logs / "trial-002.mcap").rename(logs / "trial-002.mcap.part")
    kept = (logs / "trial-000.mcap").stat().st_mtime_ns
    refused = run("quick.yaml", "--out", "logs", cwd=work)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "logs: holds logs already" in refused.stderr
    dry = run("quick.yaml", "--out", "logs", "--resume", "--dry-run", cwd=work)
    assert "# Trials to run: 2 of 3" in dry.stdout
    done = run("quick.yaml", "--out", "logs", "--resume", cwd=work)
    assert done.returncode == 0
    assert digests(logs) == before
    assert (logs / "trial-000.mcap").stat().st_mtime_ns == kept
    assert (logs / "trial-002.attempt-1.mcap.part").exists()
    assert "3 of 3 trials complete" in done.stdout


def test_resuming_a_complete_batch_prints_it(work):
    before = digests(work / "logs")
    done = run("quick.yaml", "--out", "logs", "--resume", "--jobs", 2, cwd=work)
    assert done.returncode == 0
    assert "3 of 3 trials complete" in done.stdout
    assert digests(work / "logs") == before


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["--out", "logs", "--seed", "8"], "trial-000.mcap: was run with another spec or seed"),
        (["--out", "logs", "--set", "robots.r.a=5"], "was run with another spec or seed"),
        ([], "--resume needs --out"),
    ],
)
def test_resuming_another_batch_is_refused(work, args, message):
    before = sorted(work.rglob("*"))
    done = run("quick.yaml", "--resume", *args, cwd=work)
    assert (done.returncode, done.stdout) == (2, "")
    assert message in done.stderr
    assert sorted(work.rglob("*")) == before


@pytest.mark.parametrize("number", first_of([signal.SIGINT, signal.SIGTERM]))
def test_one_interruption_finishes_the_step_and_the_log(tmp_path, number):
    with Running(tmp_path, ENDLESS) as running:
        running.until_logging(1, size=30_000)
        running.process.send_signal(number)
        assert running.end() == 130
        assert_interrupted(running, 1, "interrupted; the step was finished")


@pytest.mark.system
def test_a_second_interruption_does_not_wait_for_the_plan(tmp_path):
    """Two different signals, since two of one kind may arrive as one; the plan takes minutes."""
    with Running(tmp_path, HEAVY) as running:
        running.until_logging(1)
        running.process.send_signal(signal.SIGINT)
        running.process.send_signal(signal.SIGTERM)
        assert running.end() == 130
        assert_interrupted(running, 1, "stopped at once by a second interruption")


@pytest.mark.system
@pytest.mark.parametrize("everyone", [True, False], ids=["group", "parent"])
def test_one_interruption_ends_trials_in_several_processes(tmp_path, everyone):
    with Running(tmp_path, ENDLESS, "--jobs", "2") as running:
        running.until_logging(2, size=30_000)
        send = os.killpg if everyone else os.kill
        send(running.process.pid, signal.SIGINT)
        assert running.end() == 130
        assert_interrupted(running, 2, "interrupted; the step was finished")


@pytest.mark.system
def test_a_second_interruption_reaches_every_process(tmp_path):
    with Running(tmp_path, HEAVY, "--jobs", "2") as running:
        running.until_logging(2)
        running.process.send_signal(signal.SIGINT)
        running.process.send_signal(signal.SIGTERM)
        assert running.end() == 130
        assert_interrupted(running, 2, "stopped at once by a second interruption")


@pytest.mark.system
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs Linux's /proc")
def test_a_signal_to_all_while_processes_start_is_an_interruption_too(tmp_path):
    """Regression: it met workers that had not prepared for it, and the pool broke."""
    with Running(tmp_path, ENDLESS, "--jobs", "2") as running:
        running.until(lambda: len(running.workers()) == 2)
        os.killpg(running.process.pid, signal.SIGINT)
        assert running.end() == 130
        assert_interrupted(running, 2)


@pytest.mark.system
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs Linux's /proc")
def test_a_trial_whose_worker_is_killed_twice_ends_the_batch_with_a_clear_line(tmp_path):
    with Running(tmp_path, ENDLESS, "--jobs", "2") as running:
        running.until_logging(2)
        os.kill(running.workers()[0], signal.SIGKILL)
        running.until(lambda: list(running.logs.glob("*.attempt-1.*")))  # the trial runs again
        running.until(lambda: len(running.workers()) == 1)
        os.kill(running.workers()[0], signal.SIGKILL)
        assert running.process.wait(PATIENCE_S) == 1
        lines = running.err.read_text().splitlines()
        assert lines[-2].startswith("error: a trial's process was killed twice")
        assert lines[-1].startswith("hint: with fewer --jobs")


BAD_FILES = {
    "empty.yaml": b"",
    "binary.yaml": bytes(range(256)) * 4,
    "wrong.yaml": QUICK.replace("speed: 200", "speed: -1").encode(),
}


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["nowhere.yaml"], "nowhere.yaml: there is no such file"),
        (["."], ".: is a folder"),
        (["empty.yaml"], "empty.yaml: is empty"),
        (["binary.yaml"], "binary.yaml: is a binary file"),
        (["wrong.yaml"], "wrong.yaml:3:"),
        (["quick.yaml", "--set", "controler.period=1"], "did you mean 'controller'?"),
        (["quick.yaml", "--set", "robots.x.a=1"], "has no entry 'x'"),
        (["quick.yaml", "--jobs", "0"], "--jobs"),
        (["quick.yaml", "--trials", "0"], "--trials: must be at least 1"),
        (["quick.yaml", "--out", "empty.yaml"], "empty.yaml: not a folder"),
        ([], "SPEC"),
    ],
)
def test_bad_input_is_one_clear_line_and_code_2(tmp_path, args, message):
    for name, content in BAD_FILES.items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "quick.yaml").write_text(QUICK)
    before = sorted(tmp_path.iterdir())
    done = run(*args, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    errors = [line for line in done.stderr.splitlines() if not line.startswith("hint: ")]
    assert len(errors) == 1
    assert errors[0].startswith("error: ")
    assert message in errors[0]
    assert sorted(tmp_path.iterdir()) == before


def test_a_log_folder_that_cannot_be_made_is_one_clear_line(batch, tmp_path):
    (tmp_path / "file").write_text("")
    done = run(batch[0] / "quick.yaml", "--out", "file/logs", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == "error: file/logs: cannot create the folder: Not a directory\n"


def test_a_full_disk_aborts_the_trial_and_says_so(batch, tmp_path):
    def full():
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))

    done = cli.process(tmp_path, "run", batch[0] / "quick.yaml", "--out", "logs", preexec_fn=full)
    assert done.returncode == 1
    line = "error: trial 1: logs/trial-000.mcap: cannot write the log: File too large"
    assert line in done.stderr.splitlines()
    assert "logs in logs" in done.stderr
    assert (tmp_path / "logs" / "trial-000.mcap.part").exists()


@pytest.fixture
def read_only(tmp_path):
    """A folder in which not even root can write."""
    folder = tmp_path / "read-only"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "ro", "tmpfs", str(folder)]
    if os.geteuid() != 0:
        folder.chmod(0o555)
        yield folder
        folder.chmod(0o755)
    elif subprocess.run(mount, capture_output=True).returncode == 0:
        yield folder
        subprocess.run(["umount", str(folder)], check=True)
    else:
        pytest.skip("root may write everywhere and cannot mount here")


def test_a_read_only_log_folder_is_one_clear_line(batch, read_only):
    done = run(batch[0] / "quick.yaml", "--out", read_only, "--quiet", cwd=read_only.parent)
    assert (done.returncode, done.stdout) == (1, "")
    first, *rest = done.stderr.splitlines()
    assert first.startswith(f"error: {read_only}/.tetractl-lock: cannot lock the folder: ")
    assert rest == []


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
    assert "tetractl.cli.run" in imported
    heavy = {"numpy", "numba", "matplotlib", "scipy", "mcap", "google.protobuf", "pydantic"}
    if args[0] == "run":
        heavy.remove("pydantic")  # typer's own, to read a command's options
    assert heavy & imported == set()

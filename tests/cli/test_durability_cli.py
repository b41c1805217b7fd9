"""Tests of logs after real signals, kills and full disks, and of their repair."""

import json
import os
import random
import shlex
import shutil
import subprocess

import pytest
from testkit import cli
from testkit.durable import random_kill
from testkit.lateness import lateness
from testkit.paths import ROOT
from testkit.running import QUICK

from tetractl.log.read.reader import read_trial
from tetractl.run.folder_lock import locked

pytestmark = pytest.mark.slow

LOSS_S = 1.2


@pytest.fixture
def logs(folder, tmp_path):
    shutil.copytree(folder / "logs", tmp_path, dirs_exist_ok=True)
    return tmp_path


def tetractl(folder, command):
    return cli.tetractl(folder, *shlex.split(command))


@pytest.mark.parametrize("extra", [(), ("--resume",)])
def test_a_folder_in_use_is_refused(tmp_path, extra):
    """Who holds its lock is tested of the lock; here, that a run asks for it."""
    (tmp_path / "quick.yaml").write_text(QUICK)
    (tmp_path / "logs").mkdir()
    with locked(tmp_path / "logs"):
        done = cli.tetractl(tmp_path, "run", "quick.yaml", "--out", "logs", *extra)
    assert done.returncode == 2
    assert f"logs: in use by process {os.getpid()} of " in done.stderr


@pytest.mark.system
@pytest.mark.parametrize("seed", range(5))
def test_a_kill_costs_little(tmp_path, seed):
    """What this host is late is no loss of the log's."""
    with lateness() as host:
        killed = random_kill(tmp_path / "0.mcap", random.Random(seed), most_s=2.5)
    assert killed.lost_s <= LOSS_S + 2 * host.most_s


@pytest.mark.long
def test_verify_says_which_of_the_two_it_did(logs):
    done = tetractl(logs, "verify .").ok()
    assert done.stdout.count("ok: ") == done.stdout.count("re-computed, bit-identical") == 2
    document = json.loads(tetractl(logs, "verify . --json").stdout)
    assert [(log["ok"], log["problems"]) for log in document["logs"]] == [(True, [])] * 2


def test_a_trial_is_repeated_from_its_log(logs):
    done = tetractl(logs, "rerun trial-001.mcap --out again --quiet").ok()
    assert "the content digests agree: " in done.stderr
    assert [path.name for path in (logs / "again").iterdir()] == ["trial-001.mcap"]


def test_a_trial_is_run_again_under_another_controller(logs):
    was = read_trial(logs / "trial-001.mcap").start
    done = tetractl(logs, "rerun trial-001.mcap --set controller.steps_max=3 -o other -q").ok()
    again = read_trial(logs / "other" / "trial-001.mcap")
    assert (again.experiment.controller.steps_max, again.result.outcome.value) == (3, "steps max")
    assert (again.start.seed, again.start.trial) == (was.seed, was.trial)
    assert f"the total error is {again.result.total_error:.2f} mm now, and was " in done.stderr
    assert "digests" not in done.stderr


def test_a_value_that_is_set_as_it_was_makes_no_other_trial(logs):
    """Regression: their specs were said to differ."""
    steps_max = read_trial(logs / "trial-001.mcap").experiment.controller.steps_max
    setting = f"controller.steps_max={steps_max}"
    done = tetractl(logs, f"rerun trial-001.mcap --set {setting} --out same --quiet").ok()
    assert "the content digests agree: " in done.stderr
    assert "differ" not in done.stderr


@pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="there is no ssh-keygen here")
def test_the_commands_of_the_page_sign_a_log_and_notice_a_change(tmp_path):
    """What a signature covers is bytes: any file will do for a log."""
    page = (ROOT / "docs" / "reference" / "durability.md").read_text()
    section = page.partition("### Signing logs")[2].partition("\n## ")[0]
    commands = [line.strip() for line in section.splitlines() if line.startswith("    ")]
    log = tmp_path / "logs" / "batch" / "trial-000.mcap"
    log.parent.mkdir(parents=True)
    log.write_bytes(b"a log")

    def run(command):
        without_passphrase = command.replace("-t ed25519", "-t ed25519 -N ''")
        return subprocess.run(
            without_passphrase, shell=True, cwd=tmp_path, capture_output=True, text=True
        )

    done = [run(command) for command in commands]
    assert [one.returncode for one in done] == [0] * 4
    assert 'Good "tetractl" signature for the-lab' in done[-1].stdout
    log.write_bytes(b"a changed log")
    assert run(commands[-1]).returncode != 0

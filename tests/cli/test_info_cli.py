"""Tests of the command `tetractl info`, started as a user would."""

import json
import shlex
from dataclasses import replace

import numpy as np
import pytest
from testkit import cli, random_trials
from testkit.trials import SEED, three_robots, write_torn, write_trial

from tetractl.log.read.reader import content_digest

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    write_trial(folder / "whole.mcap")
    write_torn(folder / "cut.mcap.part")
    data = bytearray((folder / "whole.mcap").read_bytes())
    data[len(data) // 2] ^= 0xFF
    (folder / "flipped.mcap").write_bytes(data)
    (folder / "text.mcap").write_text("no log\n")
    return folder


def tetractl(folder, command):
    return cli.tetractl(folder, *shlex.split(command))


@pytest.mark.long
def test_it_says_what_is_in_a_log(folder):
    done = tetractl(folder, "info whole.mcap")
    assert (done.returncode, done.stderr) == (0, "")
    trial = three_robots()
    for text in (
        'robots            ["green", "blue", "red"]',
        f"steps             {trial.result.steps}",
        f"total error       {trial.result.total_error:.1f} mm",
        f"/controller/step  tetractl.ControllerStep   {len(trial.steps):>6} messages    5.0 Hz",
        "  0.00 s  info     trial 0 of three-m3pi starts\n",
        f"  8.20 s  info     sequence completed after {trial.result.steps} control steps\n",
        "spec.resolved.yaml",
        "stated and computed  ",
    ):
        assert text in done.stdout
    assert "damage" not in done.stdout
    assert "estimate" not in done.stdout
    assert "\x1b" not in done.stdout


def test_json_holds_the_same(folder):
    done = tetractl(folder, "info whole.mcap --json")
    document = json.loads(done.stdout, parse_constant=pytest.fail)
    trial = three_robots()
    assert done.returncode == 0
    assert document["run"]["seed"] == str(SEED)
    assert document["result"]["robot_errors"] == list(trial.result.robot_errors)
    assert document["result"]["outcome"] == "sequence completed"
    assert [event["level"] for event in document["events"]] == ["info", "info"]
    assert document["events"][1]["time_s"] == pytest.approx(trial.result.duration_s)
    assert document["estimate"] is None
    channels = {item["topic"]: item for item in document["channels"]}
    assert channels["/frames"]["messages"] < len(trial.mocap) / 100
    assert channels["/controller/step"]["hz"] == pytest.approx(5, rel=0.01)
    assert document["digest"] == document["stated_digest"] == content_digest(folder / "whole.mcap")
    files = {"spec.yaml", "spec.resolved.yaml", "environment.json", "layout.json"}
    assert set(document["attachments"]) == files
    assert document["damage"] is None
    assert document["size"] == (folder / "whole.mcap").stat().st_size


def test_the_last_estimate_is_told_with_its_deviations(tmp_path):
    random_trial = random_trials.trial(robots=2, steps=6)
    estimate = random_trial.steps[-1].plan.estimate
    sure = replace(
        estimate,
        a=np.array([5.4926, 3.0]),
        a_std=np.array([0.0521, 0.0]),
        speed=np.array([201.25, 150.0]),
        speed_std=np.array([12.3, 1.0]),
        heading_bias=np.array([0.0123, 0.0]),
        heading_bias_std=np.array([0.0031, 1.0]),
        dead_time=0.1503,
        dead_time_std=0.0042,
    )
    last = replace(random_trial.steps[-1], plan=replace(random_trial.steps[-1].plan, estimate=sure))
    random_trial.rounds[-1] = (random_trial.rounds[-1][0], last)
    path = random_trials.write(random_trial, tmp_path / "known.mcap")
    text = tetractl(tmp_path, f"info {path}").stdout
    assert "estimate at step 5\n" in text
    assert "a 5.493 +- 0.052 rad/s, speed 201 +- 12 mm/s, heading bias 0.0123 +- 0.0031" in text
    assert f"{'dead time':43}0.1503 +- 0.0042 s\n" in text
    document = json.loads(tetractl(tmp_path, f"info {path} --json").stdout)
    assert document["estimate"]["a"] == [5.4926, 3.0]
    assert document["estimate_step"] == 5


@pytest.mark.parametrize(
    ("log", "said"),
    [
        ("cut.mcap.part", "outcome  none, because the log breaks off before the end of the trial"),
        ("flipped.mcap", "the checksum of the data section does not match"),
    ],
)
def test_damage_is_told_and_fails(folder, log, said):
    done = tetractl(folder, f"info {log}")
    assert done.returncode == 1
    assert said in done.stdout
    assert "\ndamage\n" in done.stdout
    document = json.loads(tetractl(folder, f"info {log} --json").stdout)
    assert document["damage"]["problems"]

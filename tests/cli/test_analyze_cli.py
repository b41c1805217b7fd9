"""Tests of the command `tetractl analyze`, started as a user would."""

import json

import pytest
from testkit import cli

TWO = """
name: two
units: {length: um}
arena: {left: 0, bottom: 0, width: 3000, height: 3000}
robots:
  - {name: one, start: [500, 1000], target: [1500, 900], a: 4, speed: 300}
  - {name: two, start: [500, 2000], target: [1500, 2100], a: 3.7, speed: 300}
controller: {type: mpc, period: 0.2, time_limit: 4, horizon_max: 20,
  optimizer: {type: multistart}}
plant: {type: sim, heading_noise: 0.05}
trials: {count: 7, seed: 3}
"""

pytestmark = [pytest.mark.slow, pytest.mark.long]


def analyze(folder, *arguments):
    return cli.tetractl(folder, "analyze", "two.yaml", "--trials", 3, *arguments).ok()


def test_text_and_json_report_the_same_trials_and_no_log_is_kept(tmp_path):
    (tmp_path / "two.yaml").write_text(TWO, encoding="utf-8")
    text = analyze(tmp_path).stdout
    items = json.loads(analyze(tmp_path, "--json").stdout)
    assert "8.11 % (two, one)" in text
    assert items["most_similar"] == ["two", "one"]
    assert items["reach"]["rank"] == 4
    assert items["unit"] == "um"
    assert items["total_error"]["n"] == 3
    assert f"{items['total_error']['mean']:.3g}" in text
    assert [path.name for path in tmp_path.iterdir()] == ["two.yaml"]

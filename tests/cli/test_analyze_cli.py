"""`tetractl analyze`, as a user starts it."""

import json

import pytest
from support import cli

TWO = """
name: two
units: {length: um}
arena: {left: 0, bottom: 0, width: 3000, height: 3000}
robots:
  - {name: one, start: [500, 1000], target: [1500, 900], a: 4, speed: 300}
  - {name: two, start: [500, 2000], target: [1500, 2100], a: 3.8, speed: 300}
controller: {type: mpc, period: 0.2,
  optimizer: {type: multistart}}
plant: {type: sim, heading_noise: 0.05}
"""

pytestmark = pytest.mark.slow


def analyze(folder, *arguments):
    return cli.tetractl(folder, "analyze", *arguments)


@pytest.mark.long
def test_text_and_json(tmp_path):
    (tmp_path / "two.yaml").write_text(TWO, encoding="utf-8")
    few = ("two.yaml", "--plans", 1, "--set", "robots.1.a=3.7")
    done = analyze(tmp_path, *few).ok()
    assert "no trial was run" in done.stdout.splitlines()[0]
    assert done.stdout.splitlines()[-1].startswith("advice: two and one are ")
    printed = analyze(tmp_path, *few, "--json").stdout
    document = json.loads(printed)
    assert document["unit"] == "um"
    assert document["most_alike"] == ["two", "one"]
    assert len(document["singular_values"]) == 4
    assert f"{document['mean_total_error']:.3f}" in done.stdout

"""`tetractl validate` and `tetractl schema`, as a user starts them."""

import json
from functools import partial

import pytest
from support import cli
from support.paths import ROOT

EXPERIMENTS = ROOT / "experiments"


@pytest.fixture
def tetractl(tmp_path):
    return partial(cli.tetractl, tmp_path)


def test_good_specs_are_ok(tetractl):
    specs = sorted(EXPERIMENTS.glob("*.yaml"))
    result = tetractl("validate", *specs)
    assert result.returncode == 0
    assert result.stderr == ""
    lines = result.stdout.splitlines()
    assert len(lines) == len(specs)
    assert all(line.startswith(f"{spec}: ok: ") for spec, line in zip(specs, lines, strict=True))
    assert "name three-m3pi, robots 3, obstacles 1" in result.stdout


def test_all_problems_of_all_bad_specs_are_printed(tetractl, tmp_path):
    good = EXPERIMENTS / "three_m3pi.yaml"
    text = good.read_text("utf-8")
    number = {word: text[: text.index(word)].count("\n") + 1 for word in ("a: 6", "accept_error:")}
    (tmp_path / "one.yaml").write_text(
        text.replace("a: 6", "a: -6").replace("accept_error:", "accept_eror:"), encoding="utf-8"
    )
    (tmp_path / "two.yaml").write_text("name: [x\n", encoding="utf-8")
    result = tetractl("validate", "one.yaml", good, "two.yaml")
    assert result.returncode == 2
    one_a, one_horizon, ok, two = result.stdout.splitlines()
    assert one_a.startswith(f"one.yaml:{number['a: 6']}:")
    assert one_a.endswith("robots.0.a: -6: must be greater than 0")
    assert one_horizon == (
        f"one.yaml:{number['accept_error:']}:3: controller.accept_eror: unknown key; "
        "did you mean 'accept_error'?"
    )
    assert ok.startswith(f"{good}: ok")
    assert two.startswith("two.yaml:2:1: not valid YAML")


def test_json_holds_summaries_and_problems(tetractl, tmp_path):
    (tmp_path / "bad.yaml").write_text("name: 5\n", encoding="utf-8")
    result = tetractl("validate", EXPERIMENTS / "single_cell.yaml", "bad.yaml", "--json")
    assert result.returncode == 2
    good, bad = json.loads(result.stdout)["specs"]
    assert (good["ok"], good["name"], good["robots"], good["trials"]) == (
        True,
        "single-cell",
        1,
        10,
    )
    assert len(good["hash"]) == 64
    assert (bad["ok"], bad["path"]) == (False, "bad.yaml")
    first = next(problem for problem in bad["problems"] if problem["field"] == "name")
    assert (first["line"], first["column"], first["value"]) == (1, 7, "5")
    assert first["message"] == "must be text; put it in quotes"


def test_schema_is_printed_or_written(tetractl, tmp_path):
    printed = tetractl("schema")
    assert printed.returncode == 0
    assert json.loads(printed.stdout)["title"] == "Experiment"
    assert tetractl("schema", "-o", "new.json").returncode == 0
    assert (tmp_path / "new.json").read_text("utf-8") == printed.stdout

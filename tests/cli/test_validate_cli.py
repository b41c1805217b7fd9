"""`tetractl validate` and `tetractl schema`, as a user starts them."""

import json
import shutil
import sys
from functools import partial
from pathlib import Path

import pytest
from support import cli
from support.paths import ROOT

EXPERIMENTS = ROOT / "experiments"
TETRACTL = Path(sys.executable).with_name("tetractl")


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
    number = {word: text[: text.index(word)].count("\n") + 1 for word in ("a: 6", "horizon_max:")}
    (tmp_path / "one.yaml").write_text(
        text.replace("a: 6", "a: -6").replace("horizon_max:", "horizon_mx:"), encoding="utf-8"
    )
    (tmp_path / "two.yaml").write_text("name: [x\n", encoding="utf-8")
    result = tetractl("validate", "one.yaml", good, "two.yaml")
    assert result.returncode == 2
    one_a, one_horizon, ok, two = result.stdout.splitlines()
    assert one_a.startswith(f"one.yaml:{number['a: 6']}:")
    assert one_a.endswith("robots.0.a: -6: must be greater than 0")
    assert one_horizon == (
        f"one.yaml:{number['horizon_max:']}:3: controller.horizon_mx: unknown key; "
        "did you mean 'horizon_max'?"
    )
    assert ok.startswith(f"{good}: ok")
    assert two.startswith("two.yaml:2:1: not valid YAML")


BOMB = "a: &a [x, x]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 9)}]\n"
    for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"", "s.yaml: is empty; a spec starts with 'name:'"),
        (b"\x89PNG\r\n\x1a\n\0\0", "s.yaml: is a binary file; a spec is YAML text"),
        (b"name: \xe9\n", "s.yaml:1:7: is not UTF-8 text; save the file as UTF-8"),
        (b"#" * (2 << 20), "s.yaml: is larger than 1 MiB; a spec is a few kilobytes of YAML"),
        (b"- 1\n", "s.yaml:1:1: the top level must be a mapping of keys"),
        (b"a: 1\n---\nb: 1\n", "s.yaml:2:1: a second document starts here"),
        (BOMB.encode(), "more than 100000 values, counting every use of an alias"),
        (b"[" * 100_000, "s.yaml:1:33: nested deeper than 32 levels"),
    ],
)
def test_bad_files_are_one_line(tetractl, tmp_path, content, line):
    (tmp_path / "s.yaml").write_bytes(content)
    result = tetractl("validate", "s.yaml")
    assert result.returncode == 2
    assert len(result.stdout.splitlines()) == 1
    assert line in result.stdout
    assert result.stderr == ""


def test_duplicate_keys_have_a_line(tetractl, tmp_path):
    text = (EXPERIMENTS / "single_cell.yaml").read_text("utf-8")
    (tmp_path / "s.yaml").write_text(f"{text}name: again\n", encoding="utf-8")
    result = tetractl("validate", "s.yaml")
    assert result.returncode == 2
    line = text.count("\n") + 1
    assert result.stdout.startswith(f"s.yaml:{line}:1: name: is given twice, first in line ")


def test_missing_files_and_folders_are_bad_specs(tetractl):
    result = tetractl("validate", "none.yaml", ".")
    assert result.returncode == 2
    assert result.stdout.splitlines() == [
        "none.yaml: there is no such file",
        ".: is a folder; name a YAML file in it",
    ]


def test_settings_are_checked_with_the_spec(tetractl):
    spec = EXPERIMENTS / "three_m3pi.yaml"
    assert tetractl("validate", spec, "--set", "robots.green.a=5").returncode == 0
    result = tetractl("validate", spec, "--set", "controller.optimizer.particels=5")
    assert result.returncode == 2
    assert result.stdout == (
        "--set controller.optimizer.particels=5: controller.optimizer.particels: unknown key; "
        "did you mean 'particles'?\n"
    )


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


def test_no_spec_is_a_usage_error(tetractl):
    result = tetractl("validate")
    assert result.returncode == 2
    assert result.stdout == ""
    assert result.stderr.startswith("error: ")


def test_schema_is_printed_or_written(tetractl, tmp_path):
    printed = tetractl("schema")
    assert printed.returncode == 0
    assert json.loads(printed.stdout)["title"] == "Experiment"
    assert tetractl("schema", "-o", "new.json").returncode == 0
    assert (tmp_path / "new.json").read_text("utf-8") == printed.stdout


def test_a_schema_that_cannot_be_written_is_one_line(tetractl):
    result = tetractl("schema", "-o", "no/such/folder/new.json")
    assert result.returncode != 0
    assert len(result.stderr.splitlines()) == 1


@pytest.mark.parametrize("command", ["validate", "schema"])
def test_help_has_an_example(tetractl, command):
    assert f"tetractl {command}" in tetractl(command, "--help").stdout.partition("Example")[2]


def test_the_example_of_the_help_works(tetractl, tmp_path):
    shutil.copytree(EXPERIMENTS, tmp_path / "experiments")
    specs = sorted(path.relative_to(tmp_path) for path in tmp_path.glob("experiments/*.yaml"))
    assert tetractl("validate", *specs).returncode == 0

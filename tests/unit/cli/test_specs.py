"""Tests of `init`, `validate`, `warm` and `schema`: what they write, and their exit codes."""

import json
from types import SimpleNamespace

import pytest
from testkit.paths import ROOT

from tetractl.cli import specs as module
from tetractl.cli.specs import (
    _load_experiments,
    build_template,
    init,
    read_example_files,
    schema,
    validate,
    warm,
)
from tetractl.core.errors import Exit, UsageError
from tetractl.spec.load import parse_spec
from tetractl.spec.yaml.problems import InvalidSpecError

SPEC = """\
name: s
arena: {left: 0, bottom: 0, width: 1000, height: 1000}
robots:
  - {name: one, start: [100, 300], target: [300, 300], a: 6, speed: 200}
  - {name: two, start: [100, 700], target: [300, 700], a: 3, speed: 200}
obstacles: [{type: circle, center: [900, 900], radius: 5}]
trials: {count: 3}
"""
STUDY = "name: two\nbase: s.yaml\ntrials: {count: 4, seed: 7}\n"


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The present folder, with a spec and a study."""
    (tmp_path / "s.yaml").write_text(SPEC)
    (tmp_path / "study.yaml").write_text(STUDY)
    monkeypatch.chdir(tmp_path)
    return tmp_path


# init


@pytest.mark.parametrize(
    ("name", "file"),
    [("first", "first.yaml"), ("first.yml", "first.yml"), ("first.yaml", "first.yaml"),
     ("a.b", "a.b.yaml"), (None, "experiment.yaml"), ("3", "3.yaml")],
)  # fmt: skip
def test_init_writes_a_spec_named_after_its_file(here, capsys, name, file):
    assert init(name) == Exit.DONE
    text = (here / file).read_text()
    experiment = parse_spec(text, file).experiment
    assert experiment.name == file.rpartition(".")[0]
    assert experiment.lab is None
    said = capsys.readouterr()
    assert said.out == f"{file}\n"
    assert said.err == f"run it with: tetractl run {file}\n"


def test_init_never_overwrites(here):
    with pytest.raises(UsageError, match=r"^s\.yaml: exists already"):
        init("s")
    assert (here / "s.yaml").read_text() == SPEC


@pytest.mark.parametrize("name", ["-a", "a b", "ä", "x" * 65, ".hidden"])
def test_what_cannot_be_a_name_is_refused(here, name):
    with pytest.raises(UsageError, match="cannot be the name of an experiment"):
        init(name)


def test_a_name_may_have_as_many_characters_as_a_spec_allows(here):
    assert init("x" * 64) == Exit.DONE


@pytest.mark.parametrize(
    "options",
    [{"name": "a"}, {"lab": True}, {"camera": "optitrack"}, {"robots": "twist"}],
)
def test_an_example_is_written_as_shipped_or_not_at_all(here, options):
    with pytest.raises(UsageError, match="--example writes a file exactly as shipped"):
        init(example="three_m3pi", **options)


@pytest.mark.parametrize("options", [{"camera": "optitrack"}, {"robots": "twist"}])
def test_the_parts_of_a_lab_need_a_lab(here, options):
    with pytest.raises(UsageError, match="which needs --lab"):
        init("a", **options)
    assert init("a", lab=True, **options) == Exit.DONE
    assert "\nlab:\n" in (here / "a.yaml").read_text()


def test_a_folder_that_is_missing_is_one_line(here):
    with pytest.raises(UsageError, match=r"none/a\.yaml: cannot be written: No such file"):
        init("none/a")


def test_a_name_that_yaml_reads_as_a_number_is_quoted():
    assert parse_spec(build_template("1e3", "f"), "f").experiment.name == "1e3"
    assert parse_spec(build_template("null", "f"), "f").experiment.name == "null"
    assert "tetractl run f" in build_template("a", "f")


# examples


def test_an_example_brings_the_files_that_it_names():
    files = read_example_files("studies/dead_time")
    first = next(iter(files))
    assert first == "studies/dead_time.yaml"
    assert len(files) > 1
    for name, text in files.items():
        assert text == (ROOT / "experiments" / name).read_text()


@pytest.mark.parametrize("name", ["three_m3pi", "three_m3pi.yaml", "experiments/three_m3pi.yaml"])
def test_an_example_has_its_name_with_or_without_folder_and_ending(name):
    assert list(read_example_files(name)) == ["three_m3pi.yaml"]


def test_an_unknown_example_lists_examples_and_folders():
    with pytest.raises(UsageError) as caught:
        read_example_files("three_m3pj")
    assert caught.value.message.endswith("did you mean 'three_m3pi'?")
    listed = caught.value.hint.removeprefix("the available examples are ").split(", ")
    assert "three_m3pi" in listed
    assert "studies/" in listed
    assert not [name for name in listed if "/" in name.removesuffix("/")]


def test_an_example_is_written_once_with_what_it_names(here, capsys):
    assert init(example="studies/dead_time") == Exit.DONE
    written = capsys.readouterr().out.splitlines()
    assert written[0] == "experiments/studies/dead_time.yaml"
    assert all((here / file).is_file() for file in written)
    with pytest.raises(UsageError, match="exists already"):
        init(example="studies/dead_time")
    (here / written[0]).unlink()
    assert init(example="studies/dead_time") == Exit.DONE
    assert capsys.readouterr().out.splitlines() == [written[0]]  # the others are there


# validate


def test_valid_specs_and_studies_are_ok(here, capsys):
    assert validate([here / "s.yaml", here / "study.yaml"]) == Exit.DONE
    spec, study = capsys.readouterr().out.splitlines()
    assert spec.startswith(f"{here}/s.yaml: ok: name s, robots 2, obstacles 1, controller mpc, ")
    assert ", plant sim, trials 3" in spec
    assert study == f"{here}/study.yaml: ok: study two, arms 1, trials 4 each"


def test_one_bad_spec_of_several_is_enough(here, capsys):
    (here / "bad.yaml").write_text(SPEC.replace("a: 6", "a: -6"))
    assert validate([here / "bad.yaml", here / "s.yaml"]) == Exit.USAGE
    bad, good = capsys.readouterr().out.splitlines()
    assert bad.endswith("robots.0.a: -6: must be greater than 0")
    assert ": ok: " in good


@pytest.mark.parametrize("strict", [False, True])
@pytest.mark.parametrize("file", ["s.yaml", "study.yaml"])
def test_a_warning_is_an_error_only_with_strict(here, capsys, strict, file):
    (here / "s.yaml").write_text(SPEC.replace("a: 3", "a: 6").replace("[300, 700]", "[300, 750]"))
    assert validate([here / file], strict=strict) == (Exit.USAGE if strict else Exit.DONE)
    said = capsys.readouterr()
    assert ": ok: " in said.out
    assert len(said.err.splitlines()) == len(set(said.err.splitlines())) > 0


def test_strict_does_not_matter_without_a_warning(here):
    assert validate([here / "s.yaml"], strict=True) == Exit.DONE


def test_json_holds_the_same(here, capsys):
    (here / "bad.yaml").write_text("name: 5\n")
    assert validate([here / "s.yaml", here / "bad.yaml"], as_json=True) == Exit.USAGE
    good, bad = json.loads(capsys.readouterr().out)["specs"]
    assert (good["ok"], good["robots"], good["obstacles"], good["trials"]) == (True, 2, 1, 3)
    assert good["reach"] is None or good["reach"]
    assert bad["ok"] is False
    assert bad["problems"][0]["field"]


def test_settings_apply_to_every_spec(here, capsys):
    validate([here / "s.yaml", here / "study.yaml"], sets=["robots.0.a=-1"])
    assert "robots.0.a: -1: must be greater than 0" in capsys.readouterr().out


# warm


def test_code_is_compiled_for_specs_and_each_controller_of_studies(here):
    assert [spec.name for spec in _load_experiments([here / "s.yaml"], [])] == ["s"]
    assert len(list(_load_experiments([here / "study.yaml"], []))) == 1
    (default,) = _load_experiments([], ["robots.0.a=9"])
    assert default.robots[0].a == 9
    with pytest.raises(InvalidSpecError):
        list(_load_experiments([here / "s.yaml"], ["robots.0.a=-9"]))


def test_equal_code_is_compiled_together(here, capsys, monkeypatch):
    compiled = []
    monkeypatch.setattr(
        "tetractl.control.methods.build.warm_up", lambda spec, tell: compiled.append(spec.name)
    )
    (here / "t.yaml").write_text(SPEC.replace("name: s", "name: t"))
    (here / "p.yaml").write_text(SPEC.replace("name: s", "name: p") + "controller: {type: pso-mpc}")
    assert warm([here / "s.yaml", here / "p.yaml", here / "t.yaml"]) == Exit.DONE
    assert compiled == ["s", "t", "p"]
    assert len(capsys.readouterr().out.splitlines()) == 2


def test_compile_times_are_listed_with_the_slowest_first(here, capsys, monkeypatch):
    times = {"fast": (0.5, 1), "slow": (2.25, 3)}
    monkeypatch.setattr(
        "tetractl.tools.kernels.kernel_cache.compile_times",
        lambda: {n: SimpleNamespace(own_s=s, versions=v) for n, (s, v) in times.items()},
    )
    module._print_compile_times()
    total, _, first, second = capsys.readouterr().out.splitlines()
    assert total == "4 functions compiled in 2.8 s of processor time"
    assert first.split() == ["2.25", "3", "slow"]
    assert second.split() == ["0.50", "1", "fast"]


# schema


@pytest.mark.parametrize(("study", "title"), [(False, "Experiment"), (True, "Study")])
def test_the_schema_is_printed_or_written(here, capsys, study, title):
    schema(study=study)
    printed = capsys.readouterr().out
    assert json.loads(printed)["title"] == title
    schema(here / "schema.json", study=study)
    assert (here / "schema.json").read_text() == printed
    assert capsys.readouterr().out == ""

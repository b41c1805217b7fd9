"""Tests of `tetractl init`, started as a user would in an empty folder."""

import json
import re
import resource
from functools import partial

import pytest
from testkit import cli
from testkit.paths import ROOT

from tetractl.spec.examples import find_examples
from tetractl.spec.load import load_spec
from tetractl.study.load_study import load_study

pytestmark = pytest.mark.slow


@pytest.fixture
def tetractl(tmp_path):
    return partial(cli.tetractl, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize(
    ("options", "lab"), [([], False), (["--lab"], True)], ids=["robots", "lab"]
)
def test_a_new_spec_is_sound_and_runs_at_once(tetractl, tmp_path, options, lab):
    init = tetractl("init", "first", *options)
    assert (init.returncode, init.stdout) == (0, "first.yaml\n")
    assert init.stderr == "run it with: tetractl run first.yaml\n"
    checked = tetractl("validate", "first.yaml", "--strict")
    assert (checked.returncode, checked.stderr) == (0, "")
    assert checked.stdout.startswith("first.yaml: ok: name first, robots 2")
    experiment = load_spec(tmp_path / "first.yaml").experiment
    assert (experiment.units.length, experiment.lab is not None) == ("mm", lab)
    done = tetractl("run", "first.yaml", "--trials", 2, "--json").ok()
    result = json.loads(done.stdout)
    assert (result["n_counted"], result["obstacle_violations"]) == (2, 0)
    assert result["total_error"]["max"] < 1


@pytest.mark.long
def test_a_lab_has_the_robots_and_the_camera_that_are_asked_for(tetractl, tmp_path):
    init = tetractl("init", "lines", "--lab", "--robots", "twist").ok()
    assert init.stdout == "lines.yaml\n"
    assert tetractl("validate", "lines.yaml", "--strict").ok().stderr == ""
    lab = load_spec(tmp_path / "lines.yaml").experiment.lab
    assert (lab.camera.type, lab.actuator.type) == ("optitrack", "twist")
    bodies = [(robot.name, robot.body) for robot in lab.camera.robots]
    assert bodies == [(name, name) for name in ("green", "blue", "red")]
    done = tetractl("run", "lines.yaml", "--trials", 2, "--json").ok()
    assert json.loads(done.stdout)["total_error"]["max"] < 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["--lab", "--robots", "twits"],
            "--robots twits: unknown; did you mean 'twist'?\nhint: the known types are m3pi",
        ),
        (
            ["--robots", "twist"],
            "--camera and --robots describe a lab, which needs --lab\nhint: add --lab",
        ),
        (["--camera", "optitrack"], "--camera and --robots describe a lab, which needs --lab"),
        (
            ["--example", "three_m3pi", "--robots", "twist"],
            "--example writes a file exactly as shipped",
        ),
    ],
)
def test_labs_that_do_not_exist_are_one_line(tetractl, tmp_path, words, said):
    done = tetractl("init", "new", *words) if "--example" not in words else tetractl("init", *words)
    assert (done.returncode, said in done.stderr) == (2, True), done.stderr
    assert not list(tmp_path.iterdir())


def test_an_example_is_written_with_what_it_names(tetractl, tmp_path):
    done = tetractl("init", "--example", "studies/dead_time").ok()
    assert done.stdout == "experiments/studies/dead_time.yaml\nexperiments/three_m3pi.yaml\n"
    assert len(load_study(tmp_path / "experiments/studies/dead_time.yaml").arms) > 1
    again = tetractl("init", "--example", "experiments/three_m3pi.yaml")
    assert again.returncode == 2
    assert "experiments/three_m3pi.yaml: exists already" in again.stderr


def test_what_other_packages_bring_is_among_the_examples(tetractl, tmp_path):
    for package in ("emulator", "microscope"):
        reason = f"pip install ./packages/tetractl-{package}"
        pytest.importorskip(f"tetractl_{package}", reason=reason)
    done = tetractl("init", "--example", "faults/apriltag/drips").ok()
    assert done.stdout == "experiments/faults/apriltag/drips.yaml\n"
    tetractl("init", "--example", "two_cells").ok()
    assert load_spec(tmp_path / "experiments/two_cells.yaml").experiment.units.length == "um"
    unknown = tetractl("init", "--example", "faults/nothing")
    assert unknown.returncode == 2
    assert "there is no example named 'faults/nothing'" in unknown.stderr
    assert "tetrahymena_dish, tetrahymena_lab, two_cells, benchmark/, faults/" in unknown.stderr


def test_every_file_that_a_help_or_a_hint_names_is_an_example():
    named = re.compile(r"experiments/([\w/]+)\.yaml|--example (\w+)`")
    sources = "".join(path.read_text() for path in (ROOT / "tetractl").rglob("*.py"))
    names = {in_path or in_option for in_path, in_option in named.findall(sources)}
    assert (
        {"three_m3pi", "three_m3pi_lab", "studies/dead_time"} <= names <= {*find_examples(), "NAME"}
    )


def test_a_file_for_which_the_disk_has_no_room_is_not_left(tetractl, tmp_path):
    """Regression: an empty spec stayed, and the next `init` refused to write over it."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        done = tetractl("init", "first")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert done.returncode == 2
    assert done.stderr == "error: first.yaml: cannot be written: File too large\n"
    assert not (tmp_path / "first.yaml").exists()


def test_a_name_that_ends_in_yml_is_kept(tetractl, tmp_path):
    """Regression: `init mine.yml` wrote mine.yaml."""
    tetractl("init", "mine.yml").ok()
    assert [path.name for path in tmp_path.iterdir()] == ["mine.yml"]

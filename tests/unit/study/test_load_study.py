"""Tests of studies: their arms, and the places of problems in a study or its base spec."""

# ruff: noqa: E501 (the lines printed are long)

import json

import pytest
from testkit.paths import ROOT
from testkit.running import QUICK
from testkit.studies import STUDY, write

from tetractl.core.registries import SWEEPS
from tetractl.spec.schema import schema_of
from tetractl.spec.yaml.problems import InvalidSpecError
from tetractl.study.load_study import Study, load_study
from tetractl.study.sweep import Range

HEAD = "name: quick\nbase: spec.yaml\n"


def problem_of(folder, study, spec=QUICK):
    """The error of a study and its base spec that cannot be used."""
    path = write(folder, study, spec)
    with pytest.raises(InvalidSpecError) as caught:
        load_study(path)
    return caught.value


def lines_of(folder, error):
    """What an error says, without the folder of the files."""
    return [line.removeprefix(f"{folder}/") for line in error.lines()]


def test_the_arms_are_every_point_with_every_controller(tmp_path):
    loaded = load_study(write(tmp_path, STUDY))
    assert [arm.name for arm in loaded.arms] == [
        "many-dead_time=0-a=3",
        "many-dead_time=0-a=6",
        "many-dead_time=0.1-a=3",
        "many-dead_time=0.1-a=6",
        "few-dead_time=0-a=3",
        "few-dead_time=0-a=6",
        "few-dead_time=0.1-a=3",
        "few-dead_time=0.1-a=6",
    ]
    assert loaded.unit == "mm"
    assert loaded.paths == ("plant.dead_time", "robots.r.a")


def test_an_arm_has_the_spec_that_its_values_make_of_the_base(tmp_path):
    last = load_study(write(tmp_path, STUDY)).arms[-1]
    assert last.values == {"plant.dead_time": 0.1, "robots.r.a": 6}
    of_its_controller = "controller.optimizer.particles=5"
    assert last.sets == (of_its_controller, "plant.dead_time=0.1", "robots.r.a=6")
    assert last.spec.text == QUICK
    experiment = last.spec.experiment
    assert experiment.plant.dead_time == 0.1
    assert experiment.robots[0].a == 6
    assert experiment.controller.optimizer.particles == 5
    assert experiment.trials.count == 5
    assert experiment.trials.seed == 7


def test_settings_replace_values_of_every_arm_last(tmp_path):
    path = write(tmp_path, STUDY)
    arms = load_study(path, ["controller.optimizer.particles=7"]).arms
    assert {arm.spec.experiment.controller.optimizer.particles for arm in arms} == {7}
    assert [arm.sets for arm in arms] == [arm.sets for arm in load_study(path).arms]


@pytest.mark.parametrize(
    ("study", "lines"),
    [
        ("name: quick\n", ["study.yaml:1:1: base: is missing; add it: path of the spec that every arm changes, relative to the study's file"]),
        ("name: quick\nbase: other.yaml\n", ["study.yaml:2:7: base: other.yaml: there is no file {}/other.yaml; did you mean 'spec.yaml' or 'study.yaml'?"]),
        (HEAD + "swep: {}\n", ["study.yaml:3:1: swep: unknown key; did you mean 'sweep'?"]),
        (HEAD + "sweep: {type: gird, fields: {}}\n", ["study.yaml:3:15: sweep.type: gird: must be one of grid, list, random, sobol; did you mean 'grid'?"]),
        (HEAD + "sweep: {type: random, count: 2, fields: {plant.dead_time: {low: 2, hgh: 1}}}\n", ["study.yaml:3:59: sweep.fields.plant.dead_time.high: is missing; add it: upper end of the range", "study.yaml:3:68: sweep.fields.plant.dead_time.hgh: unknown key; did you mean 'high'?"]),
        (HEAD + "sweep: {type: random, count: 2, fields: {plant.dead_time: {low: 2, high: 1}}}\n", ["study.yaml:3:74: sweep.fields.plant.dead_time.high: 1: must be greater than the field low"]),
        (HEAD + "sweep:\n  type: grid\n  fields:\n    plant.dead_tim: [0]\n    plant.a_error:\n      - 0\n      - -1\n", ["study.yaml:6:22: sweep.fields.plant.dead_tim.0: unknown key; did you mean 'dead_time'?", "study.yaml:9:9: sweep.fields.plant.a_error.1: -1: must be at least 0"]),
        (HEAD + "sweep: {type: list, points: [{robots.s.a: 1}]}\n", ["study.yaml:3:43: sweep.points.0.robots.s.a: robots: has no entry 's'; its entries are 0 to 0 or r"]),
        (HEAD + "controllers: {a: {controller.horizon_max: many}}\n", ["study.yaml:3:43: controllers.a.controller.horizon_max: \"many\": must be a whole number"]),
        (HEAD + "sweep: {type: grid, fields: {trials.seed: [1, 2]}}\n", ["study.yaml:3:44: sweep.fields.trials.seed.0: cannot be swept; set count and seed in the study's 'trials:'", "study.yaml:3:47: sweep.fields.trials.seed.1: cannot be swept; set count and seed in the study's 'trials:'"]),
        (HEAD + "sweep: {type: grid, fields: {plant.dead_time: [0, 0.0]}}\n", ["study.yaml:3:8: sweep: gives the arm dead_time=0 twice, the second time as dead_time=0; remove one of them"]),
        (HEAD + "sweep: {type: grid, fields: {units.length: [mm, um]}}\n", ["study.yaml:3:8: sweep: has arms in mm and um, but all arms must have the same length unit"]),
        (HEAD + "trials: {count: 0}\n", ["study.yaml:3:17: trials.count: 0: must be at least 1"]),
    ],
)  # fmt: skip
def test_problems_are_reported_at_their_place_in_the_study(tmp_path, study, lines):
    error = problem_of(tmp_path, study)
    assert lines_of(tmp_path, error) == [line.format(tmp_path) for line in lines]


def test_a_problem_of_the_base_is_reported_at_its_place_there(tmp_path):
    error = problem_of(tmp_path, STUDY, QUICK.replace("speed: 200", "speed: -1"))
    line = "spec.yaml:3:72: robots.0.speed: -1: must be at least 0"
    assert lines_of(tmp_path, error) == [line]


def test_a_problem_of_the_base_that_one_arm_shows_names_that_arm(tmp_path):
    outside = QUICK.replace("[300, 500]", "[3000, 500]")
    error = problem_of(tmp_path, STUDY, outside)
    (line,) = lines_of(tmp_path, error)
    assert line.startswith("spec.yaml:3:")
    assert "many-dead_time=0-a=3" in error.hint


def test_a_lab_is_refused(tmp_path):
    spec = (ROOT / "experiments" / "three_m3pi_lab.yaml").read_text()
    without_plant = spec.replace("plant: {type: sim, dead_time: 0.02}", "")
    lab = without_plant.replace("\nlab:\n", "\nplant:\n  type: lab\n")
    error = problem_of(tmp_path, HEAD, lab)
    why = "runs in a lab, but a study can only simulate: name a spec whose plant has 'type: sim'"
    assert lines_of(tmp_path, error) == [f"study.yaml:2:7: base: spec.yaml: {why}"]


def test_the_shipped_studies_are_valid():
    files = sorted((ROOT / "experiments" / "studies").glob("*.yaml"))
    assert files
    assert all(load_study(path).arms for path in files)


def test_the_committed_schema_is_that_of_the_models():
    committed = ROOT / "experiments" / "studies" / "study.schema.json"
    assert json.loads(committed.read_text("utf-8")) == schema_of(Study), (
        "run: tetractl schema --study -o experiments/studies/study.schema.json"
    )


def test_the_reference_names_every_field():
    page = (ROOT / "docs" / "reference" / "study.md").read_text("utf-8")
    sweeps = [SWEEPS.load(name) for name in SWEEPS.names()]
    for model in (Study, Range, *sweeps):
        for field in model.model_fields:
            assert f"`{field}`" in page, field


def hashes_of(folder, study):
    return [arm.hash for arm in load_study(write(folder, study)).arms]


def test_the_number_of_trials_does_not_make_another_arm(tmp_path):
    more_trials = STUDY.replace("count: 5", "count: 6")
    assert hashes_of(tmp_path, more_trials) == hashes_of(tmp_path, STUDY)


def test_the_seed_makes_another_arm(tmp_path):
    hashes = hashes_of(tmp_path, STUDY)
    of_other_seed = hashes_of(tmp_path, STUDY.replace("seed: 7", "seed: 8"))
    assert set(of_other_seed).isdisjoint(hashes)


def test_a_study_of_the_base_alone_has_one_arm(tmp_path):
    (arm,) = load_study(write(tmp_path, HEAD)).arms
    assert arm.name == "base"
    assert arm.controller == ""
    assert arm.sets == ()
    assert arm.spec.experiment.trials.count == 20


def test_arms_whose_values_are_written_alike_have_names_that_differ(tmp_path):
    study = HEAD + "sweep: {type: grid, fields: {plant.dead_time: [0.10000001, 0.1]}}\n"
    first, second = load_study(write(tmp_path, study)).arms
    assert first.name != second.name
    assert first.name.startswith("dead_time=0.1-")

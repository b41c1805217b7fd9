"""Tests that each instance of the benchmark is valid and named in README."""

import pytest
import yaml
from instances import controllers, published, study_text
from testkit.paths import ROOT

from tetractl.spec.load import load_spec
from tetractl.spec.yaml.problems import InvalidSpecError
from tetractl.study.load_study import load_study

FOLDER = ROOT / "experiments/benchmark"
SPECS = sorted(FOLDER.glob("*.yaml"))


@pytest.mark.parametrize("path", SPECS, ids=lambda path: path.stem)
def test_an_instance_is_valid_and_told_of(path):
    spec = load_spec(path)
    experiment = spec.experiment
    assert experiment.name == path.stem
    assert experiment.trials.count == 100
    row = f"| `{path.stem}` | {len(experiment.robots)} | {len(experiment.obstacles)} |"
    assert row in (FOLDER / "README.md").read_text("utf-8")
    assert (path.parent / "../experiment.schema.json").is_file()
    assert "../experiment.schema.json" in path.read_text("utf-8").splitlines()[0]


@pytest.mark.parametrize(
    ("former", "now"),
    [("paper-bench", "paper-disturbed"), ("cells-bench", "cells-flow")],
)
def test_the_former_name_of_an_instance_is_answered_by_its_present_one(former, now):
    with pytest.raises(InvalidSpecError) as refused:
        load_spec(FOLDER / f"{former}.yaml")
    assert f"'{now}.yaml'" in refused.value.lines()[0]


@pytest.mark.parametrize("path", SPECS, ids=lambda path: path.stem)
def test_the_study_of_an_instance_is_valid(path, tmp_path):
    """Regression: the arm `published` set fields that its controller does not have any more."""
    arms = controllers(path.stem)
    study = tmp_path / "study.yaml"
    study.write_text(study_text(path.stem, "study", arms, trials=2, seed=1), encoding="utf-8")
    assert [arm.name for arm in load_study(study).arms] == list(arms)


@pytest.mark.parametrize("path", SPECS, ids=lambda path: path.stem)
def test_the_published_arm_has_the_time_limit_of_its_instance(path):
    """Regression: k_max was 100 in every instance, and ended trials before their plans, some with
    fewer steps than the longest sequence."""
    spec = load_spec(path).experiment
    settings = yaml.safe_dump(published(path.stem)["controller"], default_flow_style=True)
    arm = load_spec(path, [f"controller={settings}"]).experiment.controller
    assert (arm.steps_max + 1) * arm.period == pytest.approx(spec.controller.time_limit)
    assert arm.time_limit == pytest.approx(spec.controller.time_limit)
    assert arm.steps_max + 1 >= arm.horizon_max

"""Tests of a loaded spec: its hash, copies with other values, and the record of a trial's start."""

import json

import pytest

from tetractl.core.errors import SpecError
from tetractl.core.trial import PlantInfo
from tetractl.spec.load import parse_contents, parse_resolved
from tetractl.spec.loaded_spec import (
    arm_hash,
    attach_file,
    create_start,
    resolved_yaml,
    spec_hash,
    with_controller,
    with_seed,
)

CONTENTS = {
    "name": "s",
    "arena": {"left": 0, "bottom": 0, "width": 100, "height": 100},
    "robots": [
        {"name": "one", "start": [10, 10], "target": [20, 20], "a": 3, "speed": 20},
        {"name": "two", "start": [10, 30], "target": [20, 40], "a": 2, "speed": 20},
    ],
    "trials": {"count": 7, "seed": 5},
}


def loaded(*settings, **changes):
    return parse_contents(CONTENTS | changes, "s.yaml", settings)


@pytest.mark.parametrize(
    "setting",
    [
        "name=t",
        "robots.0.a=4",
        "robots.1.start.0=11",
        "trials.seed=6",
        "trials.count=8",
        "plant.dead_time=0.1",
        "controller.period=0.1",
        "description=x",
    ],
)
def test_every_field_changes_the_hash(setting):
    assert loaded(setting).hash != loaded().hash


def test_the_hash_is_the_same_for_the_same_experiment():
    backwards = dict(reversed(CONTENTS.items()))
    assert parse_contents(backwards, "other.yaml").hash == loaded().hash
    assert loaded("arena.left=-0.0").hash == loaded("arena.left=0.0").hash
    assert len(loaded().hash) == 64


def test_only_the_number_of_trials_does_not_change_the_hash_of_an_arm():
    arm = arm_hash(loaded().experiment)
    assert arm_hash(loaded("trials.count=8").experiment) == arm
    assert arm_hash(loaded("trials.seed=6").experiment) != arm
    assert arm_hash(loaded("robots.0.a=4").experiment) != arm


def without(data, *path):
    changed = json.loads(json.dumps(data))
    *steps, last = path
    holder = changed
    for step in steps:
        holder = holder[step]
    del holder[last]
    return changed


@pytest.mark.parametrize(
    "path",
    [("description",), ("plant", "heading_noise"), ("robots", 1, "via"), ("trials", "count")],
)
def test_a_log_without_a_newer_field_has_the_hash_of_its_own_fields(path):
    experiment = loaded().experiment
    data = json.loads(experiment.model_dump_json())
    assert spec_hash(experiment, data) == spec_hash(experiment)
    earlier = without(data, *path)
    assert spec_hash(experiment, earlier) != spec_hash(experiment)
    assert spec_hash(experiment, earlier) == spec_hash(experiment, without(data, *path))


def test_the_values_of_a_logged_spec_are_those_of_the_experiment_and_not_of_its_text():
    """So that a log whose text was changed has another hash than its experiment."""
    experiment = loaded().experiment
    data = json.loads(experiment.model_dump_json())
    data["robots"][0]["a"] = 99
    assert spec_hash(experiment, data) == spec_hash(experiment)


def test_a_key_that_tetractl_no_longer_knows_counts():
    experiment = loaded().experiment
    data = json.loads(experiment.model_dump_json())
    assert spec_hash(experiment, data | {"gone": 1}) != spec_hash(experiment)
    assert spec_hash(experiment, data | {"gone": 1}) != spec_hash(experiment, data | {"gone": 2})


def test_a_resolved_spec_is_the_same_experiment_with_every_field():
    spec = loaded()
    again = parse_resolved(spec.resolved, "log")
    assert again.experiment == spec.experiment
    assert again.hash == spec.hash
    assert "heading_noise" in spec.resolved
    assert resolved_yaml(spec.experiment) == spec.resolved


def test_another_seed_changes_nothing_else():
    spec = with_seed(loaded(), 11)
    assert (spec.experiment.trials.seed, spec.experiment.trials.count) == (11, 7)
    assert spec.experiment.robots == loaded().experiment.robots
    assert spec.name == "s.yaml"
    assert parse_resolved(spec.text, "text").experiment == spec.experiment
    with pytest.raises(SpecError, match=r"^seed: "):
        with_seed(loaded(), -1)


def test_another_controller_changes_nothing_else():
    other = loaded("controller.type=pso-mpc").experiment.controller
    spec = with_controller(loaded(), other)
    assert spec.experiment.controller is other
    assert spec.experiment.setup.period_s == other.period
    assert parse_resolved(spec.text, "text").experiment == spec.experiment


def test_a_trial_starts_with_what_its_spec_says():
    spec = loaded()
    plant = PlantInfo("sim", True, 120.0, {})
    start = create_start(spec, 3, plant, 1_700_000_000)
    assert (start.seed, start.trial, start.start_unix_ns) == (5, 3, 1_700_000_000)
    assert (start.spec_name, start.spec_hash, start.spec_text) == ("s.yaml", spec.hash, spec.text)
    assert start.resolved == spec.resolved
    assert start.setup.names == ("one", "two")
    assert (start.plant, start.attached, dict(start.packages)) == (plant, (), {})


def test_attached_files_keep_their_order(tmp_path):
    two = attach_file(attach_file((), tmp_path / "b.yaml", "B"), tmp_path / "a.yaml", "A")
    assert two == (("b.yaml", "B"), ("a.yaml", "A"))

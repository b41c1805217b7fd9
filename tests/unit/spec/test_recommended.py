"""Tests that all our specs use the defaults of the recommended controller."""

from functools import cache

import pytest
import yaml
from testkit.paths import ROOT
from testkit.paths import SPECS as FILES

from tetractl.cli.specs import build_template
from tetractl.run.model_changes import stated_model
from tetractl.spec.load import load_spec, parse_spec
from tetractl.spec.yaml.problems import InvalidSpecError

EXPERIMENTS = ROOT / "experiments"


def shipped_specs():
    """The texts of all specs in the repository: examples by their names, others by their paths."""
    paths = {path.name: path for path in FILES}
    for folder in ("benchmark", "studies/bases"):
        for path in sorted((EXPERIMENTS / folder).glob("*.yaml")):
            paths[f"{folder}/{path.name}"] = path
    return {name: path.read_text(encoding="utf-8") for name, path in paths.items()}


WRITTEN = {
    "init: robots": build_template("new", "new.yaml", lab=False),
    "init: lab": build_template("new", "new.yaml", lab=True),
}
TEXTS = shipped_specs() | WRITTEN


@cache
def spec_of(name):
    return parse_spec(TEXTS[name], name).experiment


def is_ours(text):
    """Whether the text of a spec names no other controller. Libyaml reads it: every process that
    collects tests asks this of every spec."""
    controller = yaml.load(text, yaml.CSafeLoader).get("controller", {})
    return controller.get("type", "mpc") == "mpc"


OURS = [name for name, text in TEXTS.items() if is_ours(text)]
OF_THE_LAB = {
    "dead_time",
    "time_limit",
    "horizon_max",
    "accept_error",
    "prior",
    "obstacle_weight",
    "collision.margin",
    "collision.radius",
    "collision.separation",
    "optimizer.tolerance",
    "optimizer.rounds",
}
"""What depends on bodies, delays, distances and their unit, and on the number of robots."""


def of_earlier_numbers(name):
    """What a spec says because its printed numbers are from before this was the default."""
    if name.startswith("benchmark/") or name == "tetrahymena_disturbed.yaml":
        return {"collision.adaptive"}
    return set()


def differing_fields(section, default, prefix=""):
    """The fields in which two sections of one type differ, those of inner sections with a dot."""
    fields = set()
    for field in type(section).model_fields:
        stated = getattr(section, field)
        by_default = getattr(default, field)
        if stated == by_default:
            continue
        if field in ("collision", "optimizer"):
            fields |= differing_fields(stated, by_default, f"{field}.")
        else:
            fields.add(prefix + field)
    return fields


@pytest.mark.parametrize("name", OURS)
def test_a_spec_says_only_what_is_its_labs(name):
    spec = spec_of(name)
    wheels = "wheels: {radius: 1}\n" if spec.wheels else ""
    robots = "robots: [{name: r, start: [1, 1], target: [2, 2], a: 1, speed: 1}]\n"
    text = f"name: s\narena: {{left: 0, bottom: 0, width: 9, height: 9}}\n{robots}{wheels}"
    period = [f"controller.period={spec.controller.period}"]
    default = parse_spec(text, "default.yaml", period).experiment.controller
    stated = differing_fields(spec.controller, default)
    assert stated <= OF_THE_LAB | of_earlier_numbers(name)


def test_the_published_controller_is_left_alone():
    assert "three_m3pi.yaml" in OURS
    published = load_spec(EXPERIMENTS / "three_m3pi_paper.yaml").experiment.controller
    default = type(published)()
    assert differing_fields(published, default) == {"time_limit"}
    assert published.time_limit == pytest.approx(101 * 0.2)  # of 1 + k_max steps


LAB = WRITTEN["init: lab"]


def lab_controller(*sets):
    return parse_spec(LAB, "lab.yaml", sets).experiment.controller


def test_defaults_follow_the_robots_and_their_bodies():
    controller = lab_controller("controller.collision={radius: 47}")
    assert controller.period == 0.05
    assert controller.time_limit == 160
    assert controller.arrival_tolerance == 0
    assert controller.collision.separation == 94
    assert controller.collision.stop_before_collision is True


@pytest.mark.parametrize("name", ["micro_channels.yaml", "tetrahymena.yaml"])
def test_a_prior_states_the_noise_of_the_simulated_camera(name):
    """Regression: the filter of tetrahymena.yaml had to learn the noise, and errors were greater
    (docs/decisions/filter.md)."""
    prior = spec_of(name).controller.prior
    camera = spec_of(name).plant.measurement_noise
    assert prior.position_noise == camera.position > 0
    assert prior.heading_noise == camera.heading > 0
    assert not stated_model(spec_of(name)).lacks_noise  # so no trial warns of it


@pytest.mark.parametrize(
    ("period_s", "signal_periods", "accept_error_mm"), [(0.05, 4, 8.6), (0.2, 1, 34)]
)
def test_defaults_follow_the_period(period_s, signal_periods, accept_error_mm):
    """The fastest robot drives at 380 mm/s."""
    controller = lab_controller(f"controller.period={period_s}")
    assert controller.signal_periods == signal_periods
    assert controller.accept_error == accept_error_mm


def test_a_wrong_period_is_one_error():
    with pytest.raises(InvalidSpecError) as caught:
        lab_controller("controller.period=x")
    assert str(caught.value).count("\n") == 0

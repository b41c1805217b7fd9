"""What we recommend is what the recommended controller does by default, in every spec of ours."""

import pytest
from support.paths import ROOT
from support.paths import SPECS as FILES

from tetractl.cli.specs import template
from tetractl.experiment.load import load_spec, parse_spec
from tetractl.experiment.yaml.problems import InvalidSpecError

SHIPPED = {
    path.relative_to(ROOT / "experiments").as_posix(): path.read_text(encoding="utf-8")
    for folder in ("benchmark", "studies/bases")
    for path in sorted((ROOT / "experiments" / folder).glob("*.yaml"))
} | {path.name: path.read_text(encoding="utf-8") for path in FILES}
WRITTEN = {
    f"init: {kind}": template("new", "new.yaml", kind == "lab") for kind in ("robots", "lab")
}
SPECS = {name: parse_spec(text, name).experiment for name, text in (SHIPPED | WRITTEN).items()}
OURS = [name for name, spec in SPECS.items() if spec.controller.type == "mpc"]
OF_THE_LAB = {
    *("dead_time", "time_limit", "horizon_max", "accept_error", "prior"),
    *("obstacle_weight", "collision.margin", "collision.radius", "collision.separation"),
    *("optimizer.tolerance", "optimizer.rounds"),
}
"""What depends on bodies, delays, distances and their unit, and on the number of robots."""
ALSO = {  # whose printed numbers are from before these were the defaults
    "tetrahymena_disturbed.yaml": {"collision.adaptive"},
} | {name: {"collision.adaptive"} for name in OURS if name.startswith("benchmark/")}
ALSO["benchmark/anywhere.yaml"] = {"collision.silence"}


def different(one, other, path=""):
    """The fields in which two sections differ."""
    for field in type(one).model_fields:
        ours, theirs = getattr(one, field), getattr(other, field)
        if ours != theirs:
            inside = field in ("collision", "optimizer")
            yield from different(ours, theirs, f"{field}.") if inside else [path + field]


@pytest.mark.parametrize("name", OURS)
def test_a_spec_says_only_what_is_its_labs(name):
    spec = SPECS[name]
    wheels = "wheels: {radius: 1}\n" if spec.wheels else ""
    robots = "robots: [{name: r, start: [1, 1], target: [2, 2], a: 1, speed: 1}]\n"
    text = f"name: s\narena: {{left: 0, bottom: 0, width: 9, height: 9}}\n{robots}{wheels}"
    period = [f"controller.period={spec.controller.period}"]
    default = parse_spec(text, "default.yaml", period).experiment.controller
    assert set(different(spec.controller, default)) <= OF_THE_LAB | ALSO.get(name, set())


def test_the_published_controller_is_left_alone():
    assert "three_m3pi.yaml" in OURS
    published = load_spec(ROOT / "experiments" / "three_m3pi_paper.yaml").experiment.controller
    assert set(different(published, type(published)())) == {"time_limit"}
    assert published.time_limit == pytest.approx(101 * 0.2)  # of 1 + k_max steps


LAB = WRITTEN["init: lab"]


def test_defaults_follow_the_period_the_robots_and_their_bodies():
    control = parse_spec(LAB, "lab.yaml").experiment.controller
    assert (control.period, control.signal_periods, control.time_limit) == (0.05, 4, 160)
    assert control.accept_error == 8.6  # of 380 mm/s
    assert (control.collision.separation, control.arrival_tolerance) == (94, 0)
    assert (control.collision.silence, control.collision.stop_before_collision) == (1, True)
    slow = parse_spec(LAB, "lab.yaml", ["controller.period=0.2"]).experiment.controller
    assert (slow.signal_periods, slow.accept_error) == (1, 34)


def test_a_wrong_period_is_one_error():
    with pytest.raises(InvalidSpecError) as caught:
        parse_spec(LAB, "lab.yaml", ["controller.period=x"])
    assert str(caught.value).count("\n") == 0

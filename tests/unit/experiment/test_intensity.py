"""The intensity of the signal that a spec lets its controller choose, and what does not fit it."""

import numpy as np
import pytest
from support.paths import ROOT

from tetractl.analysis.analyze import analyze
from tetractl.analysis.reach import reach
from tetractl.core.errors import UsageError
from tetractl.core.intensity import Intensity
from tetractl.experiment.load import load_spec
from tetractl.experiment.yaml.problems import InvalidSpecError
from tetractl.run.plausibility import SPEC_CHECKS, CheckContext

ROLLERS = ROOT / "experiments" / "two_rollers.yaml"
CELLS = ROOT / "experiments" / "cells_strength.yaml"
M3PI = ROOT / "experiments" / "three_m3pi_lab.yaml"
SAMPLERS = "pso-mpc with the optimiser pso, cem or mppi chooses both"


def test_the_motion_says_what_the_intensity_is():
    rollers, cells = (load_spec(path).experiment.setup for path in (ROLLERS, CELLS))
    assert rollers.intensity == Intensity("frequency", "rad/s", 0, 80, 1.0)
    assert cells.intensity == Intensity("strength", "mT", 0, 2, 2.0, gain=1.0)
    assert np.isinf(rollers.a_most).all()
    stronger = load_spec(CELLS, ["intensity.max=5"]).experiment.setup
    assert stronger.a_most == pytest.approx(2.5 * stronger.a)


@pytest.mark.parametrize(
    ("spec", "settings", "says"),
    [
        (
            ROLLERS,
            ["intensity=null"],
            "controller.motion: rollers: needs the frequency of the field",
        ),
        (ROLLERS, ["intensity.min=90"], "intensity.min: 90: must be less than max, 80"),
        (ROLLERS, ["plant.motion=exact"], "plant.motion: exact: moves by a strength of the field"),
        (ROLLERS, ["plant.cells={}"], "plant.cells: {}: do not move by the field's frequency"),
        (ROLLERS, ["controller.optimizer={type: multistart}"], SAMPLERS),
        (CELLS, ["controller={type: mpc}"], SAMPLERS),
        (CELLS, ["controller={type: ensemble}"], SAMPLERS),
        (CELLS, ["controller={type: rrt}"], SAMPLERS),
        (CELLS, ["controller={type: sequence, directions: [1]}"], SAMPLERS),
        (
            CELLS,
            ["controller.first_plan={type: square, side: 1}"],
            "drives a square at no strength",
        ),
    ],
)
def test_what_cannot_choose_or_use_it_is_one_line(spec, settings, says):
    with pytest.raises(InvalidSpecError) as caught:
        load_spec(spec, settings)
    lines = [str(problem) for problem in caught.value.problems]
    assert any(says in line for line in lines), lines
    assert all("\n" not in line for line in lines)


def test_a_strength_needs_the_one_of_the_spec(tmp_path):
    text = CELLS.read_text("utf-8").replace("{per_mT: 2.5}", "5").replace("{per_mT: 1.75}", "3.5")
    (tmp_path / "a.yaml").write_text(text, "utf-8")
    load_spec(tmp_path / "a.yaml")
    with pytest.raises(InvalidSpecError, match="at which strength"):
        load_spec(tmp_path / "a.yaml", ["strength=null"])


def test_equal_step_outs_are_refused():
    equal = load_spec(ROLLERS, ["robots.1.a=69.8"]).experiment
    says = "reach 2 of 4; one and two move alike; a of two changed from 69.8"
    assert f"reach {reach(equal)}".startswith(says)
    with pytest.raises(UsageError, match=says):
        analyze(equal, 1)
    assert str(reach(load_spec(ROLLERS).experiment)) == "4 of 4"


@pytest.mark.parametrize("spec", [ROLLERS, CELLS], ids=["rollers", "cells"])
def test_the_checks_of_directions_know_of_it(spec):
    context = CheckContext(load_spec(spec).experiment)
    assert [found for check in SPEC_CHECKS for found in check(context)] == []


def test_a_stronger_field_loosens_the_bound_of_the_error():
    def least(most):
        settings = [f"intensity.max={most}", "controller.time_limit=8", "robots.1.a=5.1"]
        return CheckContext(load_spec(CELLS, settings).experiment).least_total_error

    assert least(0.2) > least(2) == 0

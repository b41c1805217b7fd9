"""Tests that errors from pydantic are reported in tetractl's words."""

import pytest
from testkit.schema_errors import without_words

from tetractl.core.registries import SPEC_REGISTRIES
from tetractl.spec.experiment import Experiment
from tetractl.spec.load import parse_spec
from tetractl.spec.yaml.problems import InvalidSpecError

pytestmark = pytest.mark.slow


def test_every_error_that_a_spec_can_cause_has_words():
    sections = [seam.load(kind.name) for seam in SPEC_REGISTRIES for kind in seam.kinds()]
    models = [Experiment, *(s for s in sections if hasattr(s, "__pydantic_core_schema__"))]
    assert len(models) > 10
    assert without_words(*models) == set()


SPEC = """
name: x
arena: {left: 0, bottom: 0, width: 100, height: 100}
robots: [{name: r, start: [10, 50], target: [30, 50], a: 6, speed: 20}]
"""


def test_an_unknown_colour_is_told_what_is_known():
    with pytest.raises(InvalidSpecError) as error:
        parse_spec(SPEC, "x.yaml", ["robots.r.color=gren"])
    said = str(error.value)
    assert "robots.0.color: gren: is an unknown colour; did you mean 'green'?" in said
    assert "known are #rrggbb and aliceblue, antiquewhite, " in said
    for color in ("teal", "green", "'#00ff00'"):
        parse_spec(SPEC, "x.yaml", [f"robots.r.color={color}"])


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("trials: {count:5}", "trials.count:5: unknown key; a space is missing after the colon"),
        ("trials: count:5", "a space is missing after the colon: count: 5"),
        ("trials:\n  count:5\n  seed: 1", "a space is missing after the colon: count: 5"),
        (
            "obstacles: [{type: circle, center: [0,5, 1], radius: 9}]",
            "not 3; a decimal number has a point",
        ),
        ("units: {time: 0,5}", "a decimal number has a point, not a comma"),
        ("controller: {type: mpc, period: '0,5'}", "a decimal number has a point: 0.5"),
    ],
)
def test_a_slip_of_typing_is_told_how_to_be_written(line, says):
    with pytest.raises(InvalidSpecError) as error:
        parse_spec(f"{SPEC}{line}\n", "x.yaml", [])
    assert says in str(error.value)

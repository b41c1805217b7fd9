"""Keys of earlier specs: a hint in a spec, and another name in a log."""

import pytest

from tetractl.experiment.load import parse_spec
from tetractl.experiment.yaml.problems import InvalidSpecError

SPEC = """
name: earlier
arena: {{left: 0, bottom: 0, width: 9, height: 9}}
robots: [{{name: r, start: [1, 1], target: [2, 2], a: 1, speed: 1}}]
controller: {{type: {}}}
{}"""


@pytest.mark.parametrize(
    ("controller", "below", "begins", "ends"),
    [
        *(
            (
                f"{kind}, steps_max: 300",
                "",
                "earlier.yaml:5:",
                "write time_limit: [s], which is (steps_max + 1) control periods",
            )
            for kind in ("ensemble", "mpc")
        ),
        (
            "pso-mpc, steps_max: 300",
            "intensity: {max: 2}\n",
            "earlier.yaml:6:1: intensity: unknown key; a controller chooses a direction only; ",
            " only; write strength: [mT], and a: {per_mT: ...}",
        ),
        (
            "mpc, collision: {radius: 0.5, silence: 1.0}",
            "",
            "earlier.yaml:5:",
            "what a silence of the radio does; leave it out",
        ),
    ],
    ids=["ensemble's steps", "mpc's steps", "an intensity", "a silence"],
)
def test_a_key_of_an_earlier_spec_is_one_line_that_says_what_to_do(controller, below, begins, ends):
    with pytest.raises(InvalidSpecError) as caught:
        parse_spec(SPEC.format(controller, below), "earlier.yaml")
    (line,) = caught.value.lines()
    assert line.startswith(begins)
    assert line.endswith(ends)

"""Keys of earlier specs: a hint in a spec, and another name in a log."""

import pytest

from tetractl.experiment.load import parse_spec
from tetractl.experiment.yaml.problems import InvalidSpecError

SPEC = """
name: earlier
arena: {left: 0, bottom: 0, width: 9, height: 9}
robots: [{name: r, start: [1, 1], target: [2, 2], a: 1, speed: 1}]
controller: {type: %s, steps_max: 300}
"""


@pytest.mark.parametrize("kind", ["ensemble", "mpc"])
def test_steps_of_an_earlier_spec_are_to_be_written_as_a_time(kind):
    with pytest.raises(InvalidSpecError) as caught:
        parse_spec(SPEC % kind, "earlier.yaml")
    (line,) = caught.value.lines()
    assert line.startswith("earlier.yaml:5:")
    assert line.endswith("write time_limit: [s], which is (steps_max + 1) control periods")


def test_an_intensity_of_an_earlier_spec_is_told_in_one_line():
    with pytest.raises(InvalidSpecError) as caught:
        parse_spec(f"{SPEC % 'pso-mpc'}intensity: {{max: 2}}\n", "earlier.yaml")
    (line,) = caught.value.lines()
    assert line == (
        "earlier.yaml:6:1: intensity: unknown key; a controller chooses a direction only; "
        "write strength: [mT], and a: {per_mT: ...}"
    )


SILENT = """
name: earlier
arena: {left: 0, bottom: 0, width: 9, height: 9}
robots: [{name: r, start: [1, 1], target: [2, 2], a: 1, speed: 1}]
controller: {type: mpc, collision: {radius: 0.5, silence: 1.0}}
"""


def test_a_silence_of_an_earlier_spec_is_to_be_left_out():
    with pytest.raises(InvalidSpecError) as caught:
        parse_spec(SILENT, "earlier.yaml")
    (line,) = caught.value.lines()
    assert line.startswith("earlier.yaml:5:")
    assert line.endswith("what a silence of the radio does; leave it out")

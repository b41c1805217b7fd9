"""What `validate` says of a study: the warnings about the spec of each arm, each once."""

import json

import pytest
from testkit.studies import write

from tetractl.cli.specs import validate
from tetractl.core.errors import Exit

pytestmark = pytest.mark.slow

DOUBTFUL = 90  # rad/s
SOUND = 3


def study(values, more=""):
    return f"""\
name: two
base: spec.yaml
sweep: {{type: grid, fields: {{robots.r.a: {values}{more}}}}}
trials: {{count: 2, seed: 7}}
"""


def validated(folder, text, capsys, **options):
    """The exit code, the warnings on stderr, and the fields in JSON, which name the same ones."""
    path = write(folder, text)
    code = validate([path], **options)
    warnings = [line for line in capsys.readouterr().err.splitlines() if "warning: " in line]
    assert validate([path], as_json=True, **options) == code
    (fields,) = json.loads(capsys.readouterr().out)["specs"]
    assert len(fields["warnings"]) == len(warnings)
    return code, warnings, fields


def about_a(warnings):
    return [line for line in warnings if "robots.0.a: " in line]


def test_a_study_of_sound_arms_has_no_warnings(tmp_path, capsys):
    code, warnings, fields = validated(tmp_path, study([SOUND, 6]), capsys, strict=True)
    assert (code, warnings) == (Exit.DONE, [])
    assert (fields["ok"], fields["arms"], fields["trials"]) == (True, 2, 2)


@pytest.mark.parametrize("values", [[DOUBTFUL, SOUND], [SOUND, DOUBTFUL], [SOUND, DOUBTFUL, 6]])
def test_a_warning_about_any_arm_is_said(tmp_path, capsys, values):
    text = study(values)
    code, warnings, _ = validated(tmp_path, text, capsys)
    assert code == Exit.DONE
    assert len(about_a(warnings)) == 1
    assert validated(tmp_path, text, capsys, strict=True)[0] == Exit.USAGE


def test_a_warning_about_several_arms_is_said_once(tmp_path, capsys):
    text = study([DOUBTFUL, SOUND], ", plant.dead_time: [0, 0.1]")
    assert len(about_a(validated(tmp_path, text, capsys)[1])) == 1
    two = study([DOUBTFUL, DOUBTFUL + 5])
    assert len(about_a(validated(tmp_path, two, capsys)[1])) == 2


def test_each_arm_of_a_study_has_to_be_valid(tmp_path, capsys):
    path = write(tmp_path, study([SOUND, -1]))
    assert validate([path], as_json=True) == Exit.USAGE
    (fields,) = json.loads(capsys.readouterr().out)["specs"]
    assert not fields["ok"]
    assert any("a" in problem["field"] for problem in fields["problems"])

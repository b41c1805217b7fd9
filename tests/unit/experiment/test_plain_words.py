"""Whatever pydantic may find wrong is said in tetractl's words, not in pydantic's."""

import pytest
from tetractl_emulator.script import Script

from tetractl.core.registries import SPEC_REGISTRIES
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.explain import MESSAGES
from tetractl.experiment.load import parse_spec
from tetractl.experiment.yaml.problems import InvalidSpecError

pytestmark = pytest.mark.slow

ERRORS = {  # of a schema, those that data out of YAML can cause in strict mode
    "int": {"int_type", "int_from_float"}
    | {"greater_than", "greater_than_equal", "less_than", "less_than_equal"},
    "float": {"float_type", "finite_number"},
    "bool": {"bool_type"},
    "str": {"string_type", "string_unicode", "string_too_short", "string_too_long"}
    | {"string_pattern_mismatch"},
    "tuple": {"tuple_type", "too_short", "too_long", "missing"},
    "dict": {"dict_type", "too_long"},
    "model": {"model_type"},
    "model-fields": {"model_attributes_type", "missing", "extra_forbidden"},
    "literal": {"literal_error"},
}
SILENT = {  # can cause no error, or one that is raised with words of its own
    "any", "default", "definition-ref", "definitions", "function-after", "function-before",
    "function-plain", "function-wrap", "is-instance", "model-field", "nullable", "no-info",
    "tagged-union", "union", "with-info",
}  # fmt: skip


def kinds_of(schema):
    """Yield the kinds of schemas in a schema."""
    if isinstance(schema, dict):
        if isinstance(schema.get("type"), str):
            yield schema["type"]
        for key, value in schema.items():
            if key not in ("metadata", "serialization", "default", "expected"):
                yield from kinds_of(value)
    elif isinstance(schema, list | tuple):
        for item in schema:
            yield from kinds_of(item)


def test_every_error_that_a_spec_or_script_can_cause_has_words():
    sections = [seam.load(kind.name) for seam in SPEC_REGISTRIES for kind in seam.kinds()]
    models = [Experiment, Script, *(s for s in sections if hasattr(s, "__pydantic_core_schema__"))]
    kinds = {kind for model in models for kind in kinds_of(model.__pydantic_core_schema__)}
    assert len(models) > 10
    assert kinds - SILENT <= set(ERRORS)
    errors = {error for kind in kinds & set(ERRORS) for error in ERRORS[kind]}
    assert errors <= set(MESSAGES)


SPEC = """
name: x
arena: {left: 0, bottom: 0, width: 100, height: 100}
robots: [{name: r, start: [10, 50], target: [30, 50], a: 6, speed: 20}]
"""


@pytest.mark.parametrize("sign", ["\N{MICRO SIGN}m", "\N{GREEK SMALL LETTER MU}m", "uM", "UM"])
def test_micrometres_in_another_spelling_are_told_how_to_be_written(sign):
    with pytest.raises(InvalidSpecError, match="must be one of um, mm, cm, m; did you mean 'um'"):
        parse_spec(SPEC, "x.yaml", [f"units.length={sign}"])


def test_an_unknown_colour_is_told_what_is_known():
    with pytest.raises(InvalidSpecError) as error:
        parse_spec(SPEC, "x.yaml", ["robots.r.color=gren"])
    said = str(error.value)
    assert "robots.0.color: gren: is an unknown colour; did you mean 'green'?" in said
    assert "known are #rrggbb and aliceblue, antiquewhite, " in said
    for color in ("teal", "green", "'#00ff00'"):
        parse_spec(SPEC, "x.yaml", [f"robots.r.color={color}"])

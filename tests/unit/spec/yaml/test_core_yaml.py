import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tetractl.spec.yaml.core_yaml import format_yaml, parse_nodes
from tetractl.spec.yaml.document import parse_value
from tetractl.spec.yaml.problems import InvalidSpecError

pytestmark = pytest.mark.slow

SCALARS = {
    "1e3": 1000, "1.5e-3": 0.0015, ".5": 0.5, "5.": 5, "100.0": 100, "-0.5": -0.5, "012": 12,
    "0o17": 15, "0x1F": 31, "1_000": "1_000", "on": "on", "yes": "yes", "No": "No", "true": True,
    "FALSE": False, "12:30": "12:30", "2020-01-01": "2020-01-01", "~": None, "": None,
    "2020-01-01T10:00:00Z": "2020-01-01T10:00:00Z", "null": None, "nulls": "nulls", '"5"': "5",
    "!!str 5": "5", "!!float 5": 5, "[1, {a: b}]": [1, {"a": "b"}], "<<": "<<", "=": "=",
}  # fmt: skip


@pytest.mark.parametrize("text", SCALARS)
def test_scalars_are_those_of_the_core_schema(text):
    parsed = parse_value(text, "here")
    assert parsed == SCALARS[text]
    assert type(parsed) is type(SCALARS[text])


@pytest.mark.parametrize(
    ("text", "line", "column", "words"),
    [
        ("a: [1,\nb: 2", 2, 5, "not valid YAML"),
        ("a: 1\n\tb: 2", 2, 1, "indent with spaces, not tabs"),
        ("a: b: c", 1, 5, "mapping values are not allowed here"),
        ("a: 1\n---\nb: 2", 2, 1, "a second document"),
        ("a: 1\nb: \x07", 2, 4, "U+0007"),
        ("a: *b", 1, 4, "undefined alias"),
        ("[" * 40, 1, 33, "nested deeper than 32 levels"),
        ("a: " + "[1, " * 60_000, 1, 125, "nested deeper"),
        pytest.param(
            "[" + "1, " * 120_000 + "]",
            1,
            299_999,
            "more than 100000 values",
            marks=pytest.mark.long,
        ),
    ],
)
def test_what_is_no_yaml_is_refused_at_its_place(text, line, column, words):
    with pytest.raises(InvalidSpecError, match=words.replace("+", r"\+")) as caught:
        parse_nodes(text, "here")
    (problem,) = caught.value.problems
    assert (problem.line, problem.column) == (line, column)


PLAIN_SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(allow_nan=False),
    st.text(),
)
PLAIN = st.recursive(
    PLAIN_SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


@given(PLAIN)
def test_dumped_data_parses_to_itself_here_and_by_yaml_1_1(data):
    assert parse_value(format_yaml(data), "here") == data
    assert yaml.safe_load(format_yaml(data)) == data

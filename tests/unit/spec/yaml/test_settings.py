"""Tests of `--set` and other options: which value they replace, and what they leave alone."""

from copy import deepcopy

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.spec.yaml.core_yaml import MAX_DEPTH
from tetractl.spec.yaml.document import Place, parse_document
from tetractl.spec.yaml.problems import InvalidSpecError
from tetractl.spec.yaml.settings import FieldValue, create_path, with_settings

TEXT = """\
name: s
arena: {left: 0, width: 9}
robots:
  - {name: one, a: 3}
  - {name: two, a: 4}
  - 7
lab:
"""


def document():
    return parse_document(TEXT, "s.yaml")


def put(*settings):
    """The data after some settings, which must cause no problem."""
    changed = with_settings(document(), settings)
    assert changed.all_problems == []
    return changed.data


def problem(*settings):
    """The only problem of some settings."""
    changed = with_settings(document(), settings)
    (only,) = changed.all_problems
    return only


@pytest.mark.parametrize("path", ["robots.1.a", "robots.two.a", " robots.two.a "])
def test_a_step_into_a_list_is_an_index_or_a_name(path):
    data = put(f"{path}=5")
    assert data["robots"] == [{"name": "one", "a": 3}, {"name": "two", "a": 5}, 7]
    assert data["arena"] == {"left": 0, "width": 9}


@pytest.mark.parametrize(
    ("text", "value"),
    [("5", 5), ("5.5", 5.5), ("[1, x]", [1, "x"]), ("{b: 1}", {"b": 1}), ("null", None), ("", None),
     ("'5'", "5"), ("a=b", "a=b")],
)  # fmt: skip
def test_a_value_is_yaml(text, value):
    assert put(f"name={text}")["name"] == value


def test_an_entry_can_be_replaced_by_its_index():
    assert put("robots.2={name: three}")["robots"][2] == {"name": "three"}


def test_the_last_of_several_settings_counts():
    assert put("arena.left=1", "arena.left=2")["arena"]["left"] == 2
    assert put("arena={left: 1}", "arena.top=3")["arena"] == {"left": 1, "top": 3}
    assert put("arena.top=3", "arena={left: 1}")["arena"] == {"left": 1}


def test_mappings_that_are_missing_or_empty_are_created():
    assert put("plant.noise.position=2")["plant"] == {"noise": {"position": 2}}
    assert put("lab.camera.type=x")["lab"] == {"camera": {"type": "x"}}
    assert put("arena.top=3")["arena"] == {"left": 0, "width": 9, "top": 3}


def test_settings_leave_the_document_itself_as_it_is():
    before = document()
    data = deepcopy(before.data)
    places = dict(before.places)
    with_settings(before, ["robots.0.a=5", "new.key=1", "robots.9.a=1"])
    assert before.data == data
    assert before.places == places
    assert before.problems == []


def test_the_value_of_an_option_is_put_as_it_is():
    changed = with_settings(document(), [FieldValue("trials.seed", "1e3", "--seed")])
    assert changed.data["trials"] == {"seed": "1e3"}
    place = changed.places["trials", "seed"]
    assert (place.origin, place.text, place.line) == ("--seed 1e3", "1e3", None)


def test_the_place_of_a_set_value_is_its_setting():
    changed = with_settings(document(), ["arena.left=5"])
    place = changed.places["arena", "left"]
    assert (place.origin, place.text, place.line) == ("--set arena.left=5", "5", None)
    assert changed.places["arena", "width"].line == 2


@pytest.mark.parametrize("setting", ["robots", "=5", "", " =5"])
def test_a_setting_needs_a_path_and_a_value(setting):
    assert "must have the form PATH=VALUE" in problem(setting).message


def test_a_path_may_have_as_many_parts_as_a_spec_is_deep():
    path = ".".join("abcdefgh"[i % 8] for i in range(MAX_DEPTH))
    value = put(f"{path}=1")
    for step in path.split("."):
        value = value[step]
    assert value == 1
    assert f"more than {MAX_DEPTH} parts" in problem(f"{path}.x=1").message


@pytest.mark.parametrize(
    ("setting", "field", "message"),
    [
        ("robots.3.a=1", "robots", "has no entry '3'; its entries are 0 to 2 or one, two"),
        ("robots.-1.a=1", "robots", "has no entry '-1'; its entries are 0 to 2 or one, two"),
        ("robots.six.a=1", "robots", "has no entry 'six'; its entries are 0 to 2 or one, two"),
        ("name.x=1", "name", "has no 'x', because it is a single value"),
        ("robots.2.x=1", "robots.2", "has no 'x', because it is a single value"),
        ("arena..x=1", "arena", "a part of the path is empty"),
        ("arena.=1", "arena", "a part of the path is empty"),
    ],
)
def test_a_path_that_leads_nowhere_is_refused(setting, field, message):
    found = problem(setting)
    assert (found.field, found.message) == (field, message)
    assert found.origin == f"--set {setting}"


def test_an_empty_list_has_no_entries():
    changed = with_settings(document(), ["robots=[]", "robots.0=1"])
    (found,) = changed.all_problems
    assert found.message == "has no entry '0'; its entries are none, because it is empty"


def test_entries_without_names_are_found_only_by_index():
    listed = parse_document("a: [1, 2]", "s")
    assert create_path(listed, ["a", "1"], Place("here")) == ("a", 1)
    with pytest.raises(InvalidSpecError, match=r"its entries are 0 to 1$"):
        create_path(listed, ["a", "2"], Place("here"))


def test_a_wrong_setting_does_not_hide_the_others():
    changed = with_settings(document(), ["nonsense", "arena.left=5", "name={", "arena.width=6"])
    assert len(changed.all_problems) == 2
    assert changed.data["arena"] == {"left": 5, "width": 6}


@given(st.lists(st.sampled_from("abc"), min_size=1, max_size=5), st.integers())
def test_a_value_is_found_where_it_was_put(steps, value):
    found = parse_document("x: 1", "s")
    changed = with_settings(found, [f"{'.'.join(steps)}={value}"])
    holder = changed.data
    for step in steps:
        holder = holder[step]
    assert holder == value
    assert changed.data["x"] == 1

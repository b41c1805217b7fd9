"""Tests of the problems of a spec: their order, their lines, and suggestions for a wrong word."""

import pytest

from tetractl.spec.yaml.problems import (
    SHOWN_PROBLEMS,
    InvalidSpecError,
    SpecProblem,
    format_loc,
    suggest_files,
    suggest_similar,
)


def test_a_problem_is_printed_from_its_place_to_what_is_wrong():
    whole = SpecProblem("s.yaml", "is wrong", 3, 7, "robots.0.a", "-1")
    assert str(whole) == "s.yaml:3:7: robots.0.a: -1: is wrong"
    assert str(SpecProblem("s.yaml", "is wrong")) == "s.yaml: is wrong"
    assert str(SpecProblem("s.yaml", "is wrong", field="a")) == "s.yaml: a: is wrong"


def test_problems_are_listed_by_line_and_column_and_those_without_a_line_at_the_end():
    places = [(None, None), (2, 9), (10, 1), (2, 1), (None, None)]
    problems = [SpecProblem("s", str(place), *place) for place in places]
    error = InvalidSpecError(problems)
    assert [(problem.line, problem.column) for problem in error.problems] == [
        (2, 1), (2, 9), (10, 1), (None, None), (None, None),
    ]  # fmt: skip
    assert error.message.splitlines() == error.lines()


@pytest.mark.parametrize("count", [1, SHOWN_PROBLEMS - 1, SHOWN_PROBLEMS])
def test_a_list_of_problems_is_shown_whole_up_to_its_greatest_length(count):
    error = InvalidSpecError(SpecProblem("s.yaml", "x", line, 1) for line in range(1, count + 1))
    assert len(error.lines()) == count
    assert "more problems" not in error.message


def test_a_longer_list_is_cut_and_says_so_once():
    error = InvalidSpecError(SpecProblem("s.yaml", "x", line, 1) for line in range(1, 103))
    *shown, last = error.lines()
    assert len(shown) == SHOWN_PROBLEMS
    assert last == "s.yaml: there are more problems; correct these first"
    assert len(error.problems) == 102


def test_in_python_an_option_is_called_a_setting():
    error = InvalidSpecError([SpecProblem("--set a=1", "is wrong"), SpecProblem("s", "also")])
    assert str(error).splitlines() == ["setting a=1: is wrong", "s: also"]
    assert error.message.splitlines()[0] == "--set a=1: is wrong"


def test_a_location_is_dotted_as_for_set():
    assert format_loc(("robots", 0, "start")) == "robots.0.start"
    assert format_loc(()) == ""
    assert "\n" not in format_loc(("a\nb",))


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("headng", "heading"),
        ("HEADING", "heading"),
        ("Speed_um", "speed_um"),
        ("speed_\N{MICRO SIGN}m", "speed_um"),
        ("speed_\N{GREEK SMALL LETTER MU}m", "speed_um"),
    ],
)
def test_the_closest_choice_is_suggested(word, meant):
    choices = ["start", "heading", "speed_um", "target"]
    assert suggest_similar(word, choices) == f"; did you mean '{meant}'?"


@pytest.mark.parametrize("word", ["xyz", "", "a" * 10_000])
def test_nothing_is_suggested_for_a_word_that_is_like_no_choice(word):
    assert suggest_similar(word, ["start", "heading"]) == ""
    assert suggest_similar("start", []) == ""


def test_a_suggestion_is_written_as_the_choice_is():
    assert suggest_similar("per_mt", ["per_mT"]) == "; did you mean 'per_mT'?"


def test_specs_with_names_like_that_of_a_missing_one_are_suggested(tmp_path):
    for name in ("mine.yaml", "mime.yml", "mine.txt", "other.yaml"):
        (tmp_path / name).touch()
    assert suggest_files(tmp_path / "mine.yml") == "; did you mean 'mine.yaml' or 'mime.yml'?"
    assert suggest_files(tmp_path / "zzzzz") == ""
    assert suggest_files(tmp_path / "no folder" / "mine.yaml") == ""


def test_at_most_three_files_are_suggested(tmp_path):
    for i in range(5):
        (tmp_path / f"spec{i}.yaml").touch()
    assert suggest_files(tmp_path / "spec.yaml").count(".yaml") == 3

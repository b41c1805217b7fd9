"""Tests of printing foreign text and error messages safely on a terminal."""

import pytest

from tetractl.core.errors import UsageError, printable
from tetractl.spec.yaml.problems import InvalidSpecError, SpecProblem


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("plain, with ü and µ", "plain, with ü and µ"),
        ("\x1b[2J", "\\x1b[2J"),
        ("\x9b2J", "\\x9b2J"),  # C1: one byte that begins a sequence
        ("a\r\nb\t\x07\x7f", "a\\r\\nb\\t\\x07\\x7f"),
        ("\u202etxt.exe", "\\u202etxt.exe"),
        ("\u2028", "\\u2028"),
        ("caf\udce9", "caf\\udce9"),  # of a file name that is not UTF-8
    ],
)
def test_nothing_is_left_that_a_terminal_obeys(text, printed):
    assert printable(text) == printed
    assert printable(text).isprintable()
    printable(text).encode()


def test_the_text_of_an_error_has_its_hint_in_words_of_python():
    error = UsageError(
        "out: this folder holds logs already", "choose another file with --out", "give a folder="
    )
    assert str(error) == "out: this folder holds logs already\nhint: give a folder="
    assert (error.message, error.hint) == (
        "out: this folder holds logs already",
        "choose another file with --out",
    )
    assert str(UsageError("alone")) == "alone"


def test_a_hint_that_names_no_option_is_the_same_in_python():
    """Regression: a command of a hint lost its dashes, and could not be given."""
    error = UsageError(
        "no lab", "`tetractl init --example three_m3pi_lab` writes a spec with a lab"
    )
    assert (
        str(error)
        == "no lab\nhint: `tetractl init --example three_m3pi_lab` writes a spec with a lab"
    )


def test_a_wrong_setting_is_no_option_in_python():
    problems = [SpecProblem("--set a=1", "no key 'a'"), SpecProblem("--set b=2", "too large")]
    error = InvalidSpecError(problems, "give it otherwise")
    assert error.message == "--set a=1: no key 'a'\n--set b=2: too large"
    said = "setting a=1: no key 'a'\nsetting b=2: too large\nhint: give it otherwise"
    assert str(error) == said

"""Text of others on a terminal, and of errors."""

import pytest

from tetractl.core.errors import UsageError, printable


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
    error = UsageError("out: holds logs already", "name another folder with --out, or add --resume")
    said = "out: holds logs already\nhint: name another folder with folder=, or add resume=True"
    assert (str(error), error.message) == (said, "out: holds logs already")
    assert str(UsageError("alone")) == "alone"
    bad = UsageError(
        "--set a=1: no key 'a'\n--set b=2: too large", "give it by --set robots.0.a=1."
    )
    assert str(bad) == (
        "setting a=1: no key 'a'\nsetting b=2: too large\nhint: give it by \"robots.0.a=1\"."
    )

"""Tests of arguments that are checked, and of texts that are cut."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.errors import (
    UsageError,
    describe_error,
    format_unit,
    printable,
    require_type,
    require_whole_number,
)


@pytest.mark.parametrize("value", [0, 1, 10**20, True, np.int64(7)])
def test_a_whole_number_from_0_is_itself(value):
    assert require_whole_number(value, "a trial") == int(value)


@pytest.mark.parametrize("value", [-1, 1.0, "3", None, [1], np.float64(2)])
def test_anything_else_is_refused(value):
    with pytest.raises(UsageError, match=r"^a trial must be a whole number of at least 0, but"):
        require_whole_number(value, "a trial")


def test_an_argument_has_the_right_type_or_is_named_with_its_own():
    require_type(3, int, "give a number")
    require_type("x", int | str, "give a number")
    with pytest.raises(UsageError, match=r"^give a number, but the value given is of type str$"):
        require_type("x", int, "give a number")


@given(st.text(max_size=40), st.integers(4, 30))
def test_a_text_is_cut_to_its_length_and_not_before(text, length):
    whole = printable(text)
    cut = printable(text, length)
    assert len(cut) <= length
    if len(whole) <= length:
        assert cut == whole
    else:
        assert cut == whole[: length - 3] + "..."


def test_a_text_of_just_the_length_is_whole():
    assert printable("abcde", 5) == "abcde"
    assert printable("abcdef", 5) == "ab..."


def test_units_are_written_as_people_do():
    assert [format_unit(unit) for unit in ("um", "mm", "um/s")] == ["µm", "mm", "µm/s"]


class UnspeakableError(Exception):
    def __str__(self) -> str:
        raise RuntimeError


def test_the_text_of_any_exception_is_one_line():
    assert describe_error(ValueError("a\n  b")) == "ValueError: a b"
    assert describe_error(ValueError()) == "ValueError"
    assert describe_error(UnspeakableError()) == "UnspeakableError: its text raises RuntimeError"
    assert len(describe_error(ValueError("x" * 5000))) == 300


def test_an_error_shows_the_line_of_the_user_that_called(tmp_path):
    def users_line():
        require_type("x", int, "give a number")

    with pytest.raises(UsageError) as caught:
        users_line()
    shown = caught.value._render_traceback_()
    assert shown[0] == "UsageError: give a number, but the value given is of type str"
    assert shown[1].endswith('require_type("x", int, "give a number")')
    assert "print_last" in shown[-1]
    assert len(shown) == 3

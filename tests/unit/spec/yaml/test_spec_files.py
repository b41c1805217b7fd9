"""Tests of reading the text of a spec and of the files that it names."""

import os
from pathlib import Path

import pytest

from tetractl.core.errors import SpecError
from tetractl.spec.yaml.problems import InvalidSpecError
from tetractl.spec.yaml.spec_files import MAX_BYTES, read_text, resolve_path


def test_a_file_is_relative_to_the_folder_of_its_spec():
    assert resolve_path(Path("/lab"), "identified", "found.yaml") == Path("/lab/found.yaml")
    assert resolve_path(Path("/lab"), "identified", "/other/f.yaml") == Path("/other/f.yaml")
    assert resolve_path(None, "identified", "/other/f.yaml") == Path("/other/f.yaml")


def test_a_relative_file_of_a_spec_without_a_folder_is_refused():
    with pytest.raises(SpecError) as caught:
        resolve_path(None, "lab.calibration", "m.yaml")
    assert caught.value.message.startswith("lab.calibration: m.yaml: this path is relative")
    assert "--set lab.calibration=/PATH" in caught.value.hint
    assert "--set" not in caught.value.in_python


def refusal(path, *args):
    with pytest.raises(InvalidSpecError) as caught:
        read_text(path, *args)
    (problem,) = caught.value.problems
    assert problem.origin == str(path)
    return problem


@pytest.mark.parametrize("text", ["", "a: 1\n", "a: 1\r\nb: é µ\n", "\ufeffa: 1"])
def test_a_text_is_read_as_it_was_written(tmp_path, text):
    path = tmp_path / "s.yaml"
    path.write_bytes(text.encode())
    assert read_text(path) == text


@pytest.mark.parametrize("size", [1, 10])
def test_a_file_may_be_as_large_as_the_limit_and_no_larger(tmp_path, size):
    path = tmp_path / "s.yaml"
    path.write_bytes(b"x" * size)
    assert read_text(path, size) == "x" * size
    path.write_bytes(b"x" * (size + 1))
    assert "is larger than" in refusal(path, size).message


def test_a_large_file_is_told_its_limit_in_mebibytes_and_a_spec_what_is_usual(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_bytes(b"x" * (MAX_BYTES + 1))
    assert refusal(path).message == "is larger than 1 MiB, but a spec is a few kilobytes of YAML"
    assert refusal(path, MAX_BYTES, "a table").message == "is larger than 1 MiB"
    path.write_bytes(b"x" * (2 * MAX_BYTES + 1))
    assert refusal(path, 2 * MAX_BYTES).message == "is larger than 2 MiB"


def test_a_missing_file_is_told_with_a_similar_name(tmp_path):
    (tmp_path / "mine.yaml").touch()
    assert refusal(tmp_path / "mina.yaml").message == (
        "there is no such file; did you mean 'mine.yaml'?"
    )
    assert refusal(tmp_path / "none" / "mina.yaml").message == "there is no such file"


def test_a_folder_is_no_file(tmp_path):
    assert refusal(tmp_path).message == "is a folder; name a YAML file in this folder"
    message = refusal(tmp_path, MAX_BYTES, "a table").message
    assert message == "is a folder; name a file in this folder"


def test_a_pipe_whose_end_may_never_come_is_not_read(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    assert refusal(tmp_path / "pipe").message == "is not a regular file"


def test_a_binary_file_is_refused_with_what_was_expected(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_bytes(b"a\0b")
    assert refusal(path).message == "is a binary file; a spec is YAML text"
    message = refusal(path, MAX_BYTES, "a table is text").message
    assert message == "is a binary file; a table is text"


@pytest.mark.parametrize(
    ("raw", "line", "column"),
    [
        (b"\xff", 1, 1),
        (b"abc\xff", 1, 4),
        (b"a\n\xff", 2, 1),
        (b"a\nbc\xff\n\xff", 2, 3),
        (b"a\n\n\n  \xe9x", 4, 3),
    ],
)
def test_the_first_byte_that_is_no_utf_8_has_its_place(tmp_path, raw, line, column):
    path = tmp_path / "s.yaml"
    path.write_bytes(raw)
    problem = refusal(path)
    assert (problem.line, problem.column) == (line, column)
    assert problem.message == "is not UTF-8 text; save the file as UTF-8"


def test_a_name_that_cannot_be_one_is_refused(tmp_path):
    with pytest.raises(InvalidSpecError, match="cannot be read"):
        read_text(tmp_path / "a\0b")
    (tmp_path / "file").touch()
    assert "cannot be read" in refusal(tmp_path / "file" / "s.yaml").message

"""Tests of files that are written completely or not at all."""

import errno

import pytest

from tetractl.core.errors import LogError, UsageError
from tetractl.tools.files import make_folder, write_atomically


@pytest.fixture
def file(tmp_path):
    return tmp_path / "report.html"


def files_in(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_file_takes_the_place_of_the_earlier_one_and_leaves_nothing_else(file):
    for data in (b"first", b"second"):
        write_atomically(file, data)
        assert file.read_bytes() == data
        assert files_in(file.parent) == [file.name]


@pytest.mark.parametrize("step", ["write_bytes", "replace"])
def test_an_earlier_file_survives_a_full_disk_and_no_part_is_left(monkeypatch, file, step):
    write_atomically(file, b"earlier")

    def fail(path, *args):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(type(file), step, fail)
    with pytest.raises(LogError, match=r"report\.html: cannot be written: No space left"):
        write_atomically(file, b"later")
    assert file.read_bytes() == b"earlier"
    assert files_in(file.parent) == [file.name]


def test_a_missing_folder_is_named_and_not_created(tmp_path):
    with pytest.raises(UsageError, match=r"the folder .*nowhere does not exist"):
        write_atomically(tmp_path / "nowhere" / "a.csv", b"")
    assert files_in(tmp_path) == []


def test_a_folder_is_made_with_its_parents_and_may_exist(tmp_path):
    for _ in range(2):
        make_folder(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()


def test_a_file_where_a_folder_should_be_is_one_line(tmp_path):
    (tmp_path / "a").write_text("")
    with pytest.raises(LogError, match="a/b: the folder cannot be created"):
        make_folder(tmp_path / "a" / "b")

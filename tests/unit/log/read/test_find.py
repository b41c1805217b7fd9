"""Paths, folders and patterns to logs."""

from pathlib import Path

import pytest

from tetractl.core.errors import UsageError
from tetractl.log.read.find import find_logs


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in (
        "a/trial-2.mcap",
        "a/trial-10.mcap",
        "a/trial-1.mcap",
        "a/trial-1.mcap.part",
        "a/trial-3.mcap.part",
        "a/trial-4.mcap.unfinished-0",
        "a/trial-2.attempt-1.mcap",
        "a/trial-2.attempt-2.mcap.part",
        "a/notes.txt",
        "b/deep/er/trial-0.mcap",
        "empty/readme.md",
    ):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
    return tmp_path


def _names(folder: Path, *paths: str) -> list[str]:
    return [str(log.relative_to(folder)) for log in find_logs(folder / path for path in paths)]


def test_a_folder_stands_for_its_logs_in_the_order_of_numbers(folder: Path) -> None:
    assert _names(folder, "a") == [
        "a/trial-1.mcap",
        "a/trial-2.mcap",
        "a/trial-3.mcap.part",
        "a/trial-10.mcap",
    ]


def test_what_was_set_aside_is_found_where_it_is_asked_for(folder: Path) -> None:
    names = {log.name for log in find_logs([folder / "a"], attempts=True)}
    assert names - {log.name for log in find_logs([folder / "a"])} == {
        "trial-2.attempt-1.mcap",
        "trial-2.attempt-2.mcap.part",
        "trial-4.mcap.unfinished-0",
    }
    assert _names(folder, "a/trial-2.attempt-1.mcap") == ["a/trial-2.attempt-1.mcap"]


def test_sub_folders_count(folder: Path) -> None:
    assert _names(folder, "b") == ["b/deep/er/trial-0.mcap"]
    assert len(_names(folder, ".")) == 5


def test_a_file_counts_whatever_its_name(folder: Path) -> None:
    assert _names(folder, "a/notes.txt") == ["a/notes.txt"]


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("a/trial-1*.mcap", ["a/trial-1.mcap", "a/trial-10.mcap"]),
        ("a/*", ["a/trial-1.mcap", "a/trial-1.mcap.part", "a/trial-2.mcap",
                 "a/trial-3.mcap.part", "a/trial-10.mcap"]),
        ("**/trial-0.mcap", ["b/deep/er/trial-0.mcap"]),
        ("[b]", ["b/deep/er/trial-0.mcap"]),
    ],
)  # fmt: skip
def test_patterns(folder: Path, pattern: str, names: list[str]) -> None:
    assert _names(folder, pattern) == names


def test_a_file_whose_name_looks_like_a_pattern_is_a_file(folder: Path) -> None:
    (folder / "odd[1].mcap").write_bytes(b"x")
    assert _names(folder, "odd[1].mcap") == ["odd[1].mcap"]


def test_each_log_comes_once_in_the_order_given(folder: Path) -> None:
    assert _names(folder, "a/trial-2.mcap", "a", "b/../a/trial-1.mcap")[:2] == [
        "a/trial-2.mcap",
        "a/trial-1.mcap",
    ]
    assert len(_names(folder, "a", "a", "a/*.mcap")) == 4


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("none.mcap", "no such file or folder"),
        ("empty", "no logs"),
        ("empty/*", "matches no log"),
        ("none/*.mcap", "matches no log"),
    ],
)
def test_nothing_found_is_a_usage_error(folder: Path, path: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        find_logs([folder / path])

"""Tests of finding logs by paths, folders and patterns."""

import pytest

from tetractl.core.errors import UsageError
from tetractl.log.read.find import find_logs


@pytest.fixture
def folder(tmp_path):
    for name in (
        "a/trial-2.mcap",
        "a/trial-10.mcap",
        "a/trial-1.mcap",
        "a/trial-1.mcap.part",
        "a/trial-3.mcap.part",
        "a/trial-2.attempt-1.mcap",
        "a/trial-2.attempt-2.mcap.part",
        "a/notes.txt",
        "b/deep/er/trial-0.mcap",
        "empty/readme.md",
        "odd/odd[1].mcap",
    ):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
    return tmp_path


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (["a"], ["a/trial-1.mcap", "a/trial-2.mcap", "a/trial-3.mcap.part", "a/trial-10.mcap"]),
        (["b"], ["b/deep/er/trial-0.mcap"]),
        (["a/notes.txt"], ["a/notes.txt"]),  # a file that is named counts, whatever its name
        (["a/trial-2.attempt-1.mcap"], ["a/trial-2.attempt-1.mcap"]),
        (["a/trial-1*.mcap"], ["a/trial-1.mcap", "a/trial-10.mcap"]),
        (["a/*"], ["a/trial-1.mcap", "a/trial-1.mcap.part", "a/trial-2.mcap",
                   "a/trial-3.mcap.part", "a/trial-10.mcap"]),
        (["**/trial-0.mcap", "[b]"], ["b/deep/er/trial-0.mcap"]),
        (["odd/odd[1].mcap"], ["odd/odd[1].mcap"]),
        (["b/**"], ["b/deep/er/trial-0.mcap"]),
        (["a/trial-2.mcap", "a", "b/../a/trial-1.mcap", "a/*.mcap"],  # each once, as they come
         ["a/trial-2.mcap", "a/trial-1.mcap", "a/trial-3.mcap.part", "a/trial-10.mcap"]),
    ],
)  # fmt: skip
def test_paths_folders_and_patterns_name_logs(folder, paths, names):
    logs = find_logs(folder / path for path in paths)
    assert [str(log.relative_to(folder)) for log in logs] == names


def test_what_was_set_aside_is_found_where_it_is_asked_for(folder):
    names = {log.name for log in find_logs([folder / "a"], attempts=True)}
    assert names - {log.name for log in find_logs([folder / "a"])} == {
        "trial-2.attempt-1.mcap",
        "trial-2.attempt-2.mcap.part",
    }


def test_a_pattern_may_be_relative_and_what_is_none_is_named(folder, monkeypatch):
    monkeypatch.chdir(folder / "b")
    assert list(map(str, find_logs(["d*/**/*.mcap"]))) == ["deep/er/trial-0.mcap"]
    assert list(map(str, find_logs(["../o*/*.mcap"]))) == ["../odd/odd[1].mcap"]
    with pytest.raises(UsageError, match=r"^a\*\*:"):
        find_logs(["a**"])

"""The folder of a rehearsal's days, whole, torn and hostile."""

import json

import pytest
from tetractl_emulator.rehearsal.kept_days import RESULTS, KeptDays

from tetractl.core.errors import LogError, UsageError


def row(day):
    kept = {"digest": "0", "seconds": 1.0, "ended": "arrived", "reason": ""}
    return {"day": day, **kept, "met": [], "violations": []}


def test_days_are_kept_from_one_command_to_the_next(tmp_path):
    folder = tmp_path / "days"
    KeptDays(folder, "spec 1").add(row(3))
    assert KeptDays(folder, "spec 1").rows == {3: row(3)}


def test_days_of_another_spec_are_refused(tmp_path):
    KeptDays(tmp_path, "spec 1")
    with pytest.raises(UsageError, match="has days of another spec"):
        KeptDays(tmp_path, "spec 2")


@pytest.mark.parametrize("torn", ['{"day": 4, "dig', "[" * 100_000, "\x00", "[4]", '{"day": 4}'])
def test_a_day_whose_line_is_torn_is_played_again(torn, tmp_path):
    """Regression: after a power cut, "a plug-in" was blamed."""
    KeptDays(tmp_path, "spec 1").add(row(3))
    with (tmp_path / RESULTS).open("a") as file:
        file.write(torn)
    kept = KeptDays(tmp_path, "spec 1")
    assert kept.unread == [2]
    kept.add(row(4))
    lines = (tmp_path / RESULTS).read_text().splitlines()
    assert [json.loads(line)["day"] for line in lines] == [3, 4]


def test_a_file_in_place_of_the_folder_is_one_line(tmp_path):
    """Regression: "a plug-in" was blamed."""
    file = tmp_path / "file"
    file.touch()
    for folder in (file, file / "days"):
        with pytest.raises(UsageError, match="is not a folder"):
            KeptDays(folder, "spec 1")


def test_a_full_disk_is_one_line_that_names_the_file(tmp_path):
    kept = KeptDays(tmp_path, "spec 1")
    (tmp_path / RESULTS).symlink_to("/dev/full")
    with pytest.raises(LogError, match=r"days\.jsonl: cannot be written: No space left"):
        kept.add(row(1))

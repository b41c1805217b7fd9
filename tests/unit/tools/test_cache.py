"""Tests of the folder for compiled code, which only this user can write to."""

import os
import stat
from pathlib import Path

import pytest

from tetractl.tools import cache
from tetractl.tools.cache import (
    FOLDER_VARIABLE,
    cache_folder,
    claim_folder,
    describe_exposure,
    read_checked_file,
)


@pytest.fixture(autouse=True)
def fresh(monkeypatch):
    """Each test finds an empty folder, and the variable as it was afterwards."""
    monkeypatch.setenv(FOLDER_VARIABLE, "")
    cache_folder.cache_clear()
    cache.print_note_once.cache_clear()
    yield
    cache_folder.cache_clear()


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def test_the_folder_is_the_users_alone(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "new"))
    folder = cache_folder()
    assert folder == tmp_path / "new" / "tetractl"
    assert mode(folder) == 0o700
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("exposes", ["itself", "its parent"])
def test_a_folder_that_others_can_write_to_is_not_used(tmp_path, monkeypatch, capsys, exposes):
    base = tmp_path / "shared"
    (base / "tetractl").mkdir(parents=True)
    (base if exposes == "its parent" else base / "tetractl").chmod(0o777)
    monkeypatch.setenv("XDG_CACHE_HOME", str(base))
    folder = cache_folder()
    assert not folder.is_relative_to(base)
    assert mode(folder) == 0o700
    assert list(folder.iterdir()) == []
    assert os.environ[FOLDER_VARIABLE] == str(folder)  # for worker processes
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "others can write to" in said


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_a_folder_of_another_user_is_not_used(tmp_path):
    """Regression: the temporary folder's `tetractl-UID` was used, whatever user had made it."""
    folder = tmp_path / "tetractl"
    folder.mkdir(mode=0o700)
    os.chown(folder, 12345, 12345)
    assert claim_folder(folder) == f"{folder} belongs to another user"
    os.chown(folder, 0, 0)
    os.chown(tmp_path, 12345, 12345)
    assert describe_exposure(folder) == f"{tmp_path} belongs to another user"


def test_a_link_into_a_shared_folder_is_not_used(tmp_path):
    shared = tmp_path / "shared"
    (shared / "mine").mkdir(parents=True)
    shared.chmod(0o777)
    (tmp_path / "tetractl").symlink_to(shared / "mine")
    assert claim_folder(tmp_path / "tetractl") == f"others can write to {shared}"


def test_a_folder_that_cannot_be_made_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    assert "Not a directory" in str(claim_folder(tmp_path / "file" / "tetractl"))


def test_a_file_to_which_others_can_write_is_not_read(tmp_path):
    file = tmp_path / "code.kernel"
    file.write_bytes(b"code")
    file.chmod(0o646)
    with pytest.raises(PermissionError, match="other users can write"):
        read_checked_file(file)
    file.chmod(0o600)
    assert read_checked_file(file) == b"code"


@pytest.mark.skipif(os.getuid() != 0, reason="gives a file to another user")
def test_a_file_of_another_user_is_not_read(tmp_path):
    """Regression: in the user's own folder, whose mode was mended, it was executed."""
    file = tmp_path / "code.kernel"
    file.write_bytes(b"code")
    os.chown(file, 65534, -1)
    with pytest.raises(PermissionError, match="belongs to another user"):
        read_checked_file(file)


def test_without_a_home_there_is_a_folder(monkeypatch, capsys):
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)

    def homeless():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", homeless)
    assert mode(cache_folder()) == 0o700
    assert "the user has no home" in capsys.readouterr().err

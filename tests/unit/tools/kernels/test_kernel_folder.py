"""Tests of the folders from which compiled code is loaded, and in which it is kept."""

from types import SimpleNamespace

import pytest

from tetractl.tools.kernels import kernel_cache
from tetractl.tools.kernels.kernel_cache import find_kernel_folder, find_shipped_folder


@pytest.fixture
def chosen(monkeypatch, tmp_path):
    """Choose the folder again, with the user's cache in `user`; returns what is said."""
    said = []
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(kernel_cache, "cache_folder", lambda: tmp_path / "user")
    monkeypatch.setattr(kernel_cache, "print_note_once", said.append)

    def choose():
        find_kernel_folder.cache_clear()
        try:
            return find_kernel_folder()
        finally:
            find_kernel_folder.cache_clear()

    return SimpleNamespace(choose=choose, said=said)


def test_code_is_kept_in_the_users_cache(chosen, tmp_path):
    place = chosen.choose()
    assert place.parent == tmp_path / "user"
    assert place.name.startswith("kernels-")
    assert place.is_dir()
    assert chosen.said == []


def test_a_named_folder_takes_the_place_of_the_users_cache(chosen, tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "mine"))
    assert chosen.choose().parent == tmp_path / "mine"
    assert not (tmp_path / "user").exists()
    assert chosen.said == []


def test_a_named_folder_that_cannot_be_used_is_told_and_the_users_is_used(
    chosen, tmp_path, monkeypatch
):
    (tmp_path / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    assert chosen.choose().parent == tmp_path / "user"
    (line,) = chosen.said
    assert line.startswith("NUMBA_CACHE_DIR is not used: ")


def test_without_any_folder_code_is_not_kept_and_that_is_told(chosen, tmp_path, monkeypatch):
    (tmp_path / "user").touch()
    assert chosen.choose() is None
    assert chosen.said[0].startswith("compiled code cannot be kept: ")

    def fail():
        raise OSError(28, "No space left")

    monkeypatch.setattr(kernel_cache, "cache_folder", fail)
    assert chosen.choose() is None
    assert chosen.said[1] == "compiled code cannot be kept: No space left"


def test_other_settings_of_the_compiler_have_another_folder(chosen, monkeypatch):
    plain = chosen.choose()
    monkeypatch.setenv("NUMBA_OPT", "1")
    assert chosen.choose() != plain
    monkeypatch.delenv("NUMBA_OPT")
    assert chosen.choose() == plain


@pytest.mark.parametrize(
    ("there", "settings", "lacking", "is_used"),
    [
        (True, "none", "", True),
        (False, "none", "", False),
        (True, "NUMBA_OPT=1", "", False),
        (True, "none", "the last", False),
    ],
)
def test_shipped_code_runs_only_with_its_settings_on_a_processor_that_can(
    monkeypatch, tmp_path, there, settings, lacking, is_used
):
    place = tmp_path / "shipped"
    if there:
        place.mkdir()
    features = dict.fromkeys(kernel_cache._NEEDED_FEATURES.split(), True)
    if lacking:
        features[list(features)[-1]] = False
    monkeypatch.setattr(kernel_cache, "SHIPPED", place)
    monkeypatch.setattr(kernel_cache, "compiler_settings", lambda: settings)
    monkeypatch.setattr(
        kernel_cache, "binding", SimpleNamespace(get_host_cpu_features=lambda: features)
    )
    find_shipped_folder.cache_clear()
    assert (find_shipped_folder() == place) is is_used
    find_shipped_folder.cache_clear()

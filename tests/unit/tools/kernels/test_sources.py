"""Tests that code is compiled again once its sources have changed."""

import importlib
import sys
from collections import namedtuple
from collections.abc import Iterator
from typing import Any

import pytest
from numba import float64, types

from tetractl.tools.kernels.sources import digest_dependencies

ENTRY = """
from numba import njit
from stranger_parts import GAIN, halved
from stranger_parts import Lanes

@njit
def kernel(x):
    return GAIN * halved(x)

def plain(x):
    return kernel(x)
"""
PARTS = """
from collections import namedtuple
from numba import njit
import stranger_deep

GAIN = 3.0
Lanes = namedtuple("Lanes", "a b")

@njit
def halved(x):
    return stranger_deep.half(x)
"""
DEEP = """
from numba import njit

@njit
def half(x):
    return x / 2
"""


@pytest.fixture
def stranger(tmp_path, monkeypatch) -> Iterator[Any]:
    """A package of another: returns the digest of its kernel after a file has been edited."""
    files = {"stranger_entry": ENTRY, "stranger_parts": PARTS, "stranger_deep": DEEP}
    monkeypatch.syspath_prepend(str(tmp_path))

    def after(edited: str = "stranger_entry", old: str = "", new: str = "") -> str:
        from tetractl.tools.cache import file_digest

        file_digest.cache_clear()
        for name, text in files.items():
            text = text.replace(old, new) if name == edited and old else text
            (tmp_path / f"{name}.py").write_text(text)
            sys.modules.pop(name, None)
        sys.dont_write_bytecode = True
        importlib.invalidate_caches()
        entry = importlib.import_module("stranger_entry")
        return digest_dependencies(entry.kernel.py_func, (float64,))

    yield after
    for name in files:
        sys.modules.pop(name, None)


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("stranger_entry", "GAIN * halved(x)", "GAIN + halved(x)"),
        ("stranger_parts", "half(x)", "half(x) + 1"),
        ("stranger_deep", "x / 2", "x / 3"),  # two calls away, through a module's attribute
        ("stranger_parts", "GAIN = 3.0", "GAIN = 4.0"),
    ],
)
def test_an_edit_of_what_a_kernel_calls_changes_the_digest(stranger, file, old, new):
    """Regression: only tetractl's own folders counted, so another package's old code ran."""
    assert stranger(file, old, new) != stranger()


def test_a_constant_that_is_computed_counts_by_its_value():
    def digest_with(gain):
        def kernel(x):
            return gain * x

        return digest_dependencies(kernel, (float64,))

    assert digest_with(2.0) == digest_with(2.0)
    assert digest_with(2.0) != digest_with(3.0)


def test_the_module_of_an_arguments_class_counts(tmp_path, monkeypatch):
    """Steps of a motion are found by the class of its constants, which no code names."""
    from tetractl.tools.cache import file_digest

    monkeypatch.syspath_prepend(str(tmp_path))
    digests = []
    for text in ("STEP = 1", "STEP = 2"):
        (tmp_path / "stranger_lanes.py").write_text(text)
        file_digest.cache_clear()
        importlib.invalidate_caches()
        importlib.import_module("stranger_lanes")
        lanes = namedtuple("Lanes", "a b", module="stranger_lanes")
        kind = types.NamedTuple([float64, float64], lanes)
        digests.append(digest_dependencies(lambda lanes: lanes, (types.Tuple([kind]),)))
    sys.modules.pop("stranger_lanes")
    assert digests[0] != digests[1]


def test_the_same_sources_give_the_same_digest(stranger):
    assert stranger() == stranger()

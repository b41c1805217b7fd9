"""Tests that the generated API reference lists what `import tetractl` provides."""

import re
from types import FunctionType

from testkit.paths import ROOT

import tetractl

PAGE = (ROOT / "docs" / "site" / "api.rst").read_text()


def test_every_function_is_in_the_reference():
    listed = set(re.findall(r"autofunction:: tetractl\.(\w+)", PAGE))
    functions = {
        name for name in tetractl.__all__ if isinstance(getattr(tetractl, name), FunctionType)
    }
    assert listed == functions


def test_every_type_is_in_the_reference():
    for name in tetractl.__all__:
        given = getattr(tetractl, name)
        if isinstance(given, type):
            assert given.__module__ in PAGE or name == "Experiment", name

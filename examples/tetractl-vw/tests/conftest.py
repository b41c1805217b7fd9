"""Tests find the kinds of the package as if it were installed."""

import tomllib

import pytest
from testkit.paths import ROOT
from tetractl_emulator.registries import EMULATED_ACTUATORS, EMULATED_CAMERAS

from tetractl.core.registries import ACTUATORS, CAMERAS


@pytest.fixture(autouse=True)
def installed(monkeypatch):
    """The entry points of pyproject.toml."""
    text = (ROOT / "examples" / "tetractl-vw" / "pyproject.toml").read_text()
    points = tomllib.loads(text)["project"]["entry-points"]
    for registry in (CAMERAS, ACTUATORS, EMULATED_CAMERAS, EMULATED_ACTUATORS):
        for name, code in points[registry.group].items():
            monkeypatch.setitem(registry.builtin, name, code)

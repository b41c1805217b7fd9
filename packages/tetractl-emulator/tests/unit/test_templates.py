"""Tests of what the specs from `tetractl init --lab` say about the emulated lab."""

import pytest
from testkit.cli import tetractl
from tetractl_emulator.m3pi.wheeled_side import TrueWheels

from tetractl.core.errors import SpecError
from tetractl.spec.load import load_spec, parse_spec
from tetractl.spec.plants import select_plant


@pytest.mark.parametrize("robots", ["twist", "m3pi-xbee"])
def test_a_template_says_with_which_lag_emulated_wheels_follow(tmp_path, robots):
    """Regression: without it, the model did not fit in each of 20 emulated trials."""
    tetractl(tmp_path, "init", "shelf", "--lab", "--robots", robots).ok()
    loaded = load_spec(tmp_path / "shelf.yaml")
    emulated_s = TrueWheels.model_fields["lag"].default
    assert select_plant(loaded, "emulated").experiment.setup.lag_s == emulated_s
    assert select_plant(loaded, "lab").experiment.setup.lag_s == emulated_s
    assert loaded.experiment.setup.lag_s == 0, "simulated wheels of this spec have no lag"


def test_a_lag_without_wheels_is_refused(tmp_path):
    tetractl(tmp_path, "init", "shelf", "--lab", "--robots", "twist").ok()
    text = (tmp_path / "shelf.yaml").read_text(encoding="utf-8").replace("wheels: {", "# {")
    with pytest.raises(SpecError, match=r"lab\.lag: 0\.04: is for robots on wheels"):
        select_plant(parse_spec(text, "shelf", []), "emulated")

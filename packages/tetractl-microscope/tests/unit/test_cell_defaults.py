"""Tests of the recommended controller's defaults for cells, which cannot stand still."""

import pytest
from testkit.paths import EXAMPLES

from tetractl.spec.load import load_spec
from tetractl.spec.yaml.problems import InvalidSpecError

CELLS = EXAMPLES / "two_cells.yaml"


def test_cells_are_not_made_to_pause():
    assert load_spec(CELLS).experiment.controller.collision.stop_before_collision is False


def test_robots_that_cannot_stand_still_are_not_to_pause():
    with pytest.raises(InvalidSpecError, match="is only for robots that can stand still"):
        load_spec(CELLS, ["controller.collision.stop_before_collision=true"])

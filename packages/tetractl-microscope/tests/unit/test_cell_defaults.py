"""What the recommended controller does by default for cells, which cannot stand still."""

from testkit.paths import EXAMPLES

from tetractl.spec.load import load_spec

CELLS = EXAMPLES / "two_cells.yaml"


def test_cells_are_not_made_to_pause():
    assert load_spec(CELLS).experiment.controller.collision.stop_before_collision is False

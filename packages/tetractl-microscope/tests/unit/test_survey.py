"""`tetractl lab survey -o`: the spec that it writes, in any folder."""

from types import SimpleNamespace

from tetractl_microscope.survey import _choice_line


def test_a_choice_with_a_cell_near_the_edge_says_so():
    """Regression: the best choice stood at the edge, and only the list of cells said so."""
    cells = [SimpleNamespace(number=3, free=True), SimpleNamespace(number=7, free=False)]
    proposal = SimpleNamespace(numbers=[3, 7], cells=cells, error=41.2)
    line = _choice_line(proposal, "um")
    assert line.startswith("cells 3, 7: predicted mean total error 41 um;")
    assert line.endswith("near the edge: cell 7")
    cells[1].free = True
    assert _choice_line(proposal, "um") == "cells 3, 7: predicted mean total error 41 um"

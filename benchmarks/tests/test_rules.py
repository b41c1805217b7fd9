"""Each rule that `rules.py` asks can be taken out of the controller."""

from unittest.mock import patch

import pytest
from rules import RULES, line
from worlds import WORLDS


@pytest.mark.parametrize("name", RULES)
def test_a_rule_is_a_part_of_the_controller(name):
    """A replacement raises AttributeError if the controller has nothing of that name."""
    rule = RULES[name]
    try:
        rule.take_out()
    finally:
        patch.stopall()
    worlds = [world.split(" ")[0].removesuffix("-5hz") for world in rule.helps]
    assert set(worlds) <= set(WORLDS)


def test_a_line_tells_pairs_with_a_rule_from_those_without_it():
    with_rule = {"error": 5.0, "seconds": 10.0, "touches": 0.0}
    without_rule = {"error": 105.0, "seconds": 8.0, "touches": 1.0}
    cells = line("detours", "base", [(with_rule, without_rule)] * 2).strip("| ").split(" | ")
    assert cells[2:4] == ["2, 0", "+100.00 [100.00, 100.00]"]
    assert cells[4:] == ["-2.00 [-2.00, -2.00]", "0, 2", "0, 2"]

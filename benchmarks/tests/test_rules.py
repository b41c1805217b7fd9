"""Tests that each rule in `rules.py` can be disabled in the controller."""

from unittest.mock import patch

import pytest
from rules import RULES
from worlds import WORLDS
from worlds.trials import Row, Task, pair_lines


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


def row(error, seconds, edge):
    return Row(error, seconds, 1.0, edge, 50.0, 50.0, late_steps=0.0, step_ms=1.0)


def test_a_line_tells_pairs_with_a_rule_from_those_without_it():
    tasks = [Task(1, "base", trial) for trial in range(2)]
    with_rule = dict.fromkeys(tasks, row(5.0, 10.0, edge=3.0))
    without_rule = dict.fromkeys([*tasks, Task(2, "base", 0)], row(105.0, 8.0, edge=-1.0))
    everywhere, base = pair_lines("detours", with_rule, without_rule)
    cells = base.strip("| ").split(" | ")
    assert cells[1:4] == ["base", "2, 0", "+100.00 [100.00, 100.00]"]
    assert cells[4:] == ["-2.00 [-2.00, -2.00]", "0, 2", "0, 2"]
    assert everywhere == base.replace("| base |", "| all robots |")

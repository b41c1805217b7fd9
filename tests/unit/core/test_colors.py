"""Tests that each colour has one meaning, stated in one place."""

import json
import re

from testkit.paths import ROOT
from testkit.trials import experiment

from tetractl.core.colors import (
    ALARM,
    GREY,
    OBSTACLE,
    OBSTACLE_EDGE,
    PALETTE,
    SLATES,
    robot_colors,
)
from tetractl.log.format.layout import layout


def test_no_colour_has_two_meanings():
    colors = [*PALETTE, *SLATES, GREY, OBSTACLE, OBSTACLE_EDGE, ALARM]
    assert len(set(colors)) == len(colors)


def test_the_report_has_these_colours_on_a_light_page():
    page = (ROOT / "tetractl" / "report" / "assets" / "page.css").read_text()
    light = dict(re.findall(r"--([\w-]+): (#\w+);", page[: page.index("}")]))
    assert light["obstacle"].upper() == OBSTACLE
    assert light["obstacle-edge"].upper() == OBSTACLE_EDGE
    assert light["whole"].upper() == SLATES[0]
    assert light["error"].upper() == ALARM


def test_curves_of_a_viewer_have_the_hue_of_a_robot_only_if_they_are_of_one():
    """Regression: J and the solve time were blue, and the control period had the colour of
    faults."""
    setup = experiment().setup
    of_robots = {*robot_colors(setup.names, setup.colors)}
    panels = json.loads(layout(setup))["configById"].values()
    curves = [curve for panel in panels for curve in panel.get("paths", ())]
    for curve in curves:
        assert (curve["color"] in of_robots) == (curve["label"] in setup.names), curve
        assert curve["color"] in {*of_robots, *SLATES, GREY}

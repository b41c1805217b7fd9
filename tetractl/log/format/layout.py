"""The layout in which Lichtblick and Foxglove show a trial, as JSON that they import from a file.

The format is Lichtblick's `LayoutData`: `configById` contains the settings of each panel,
under its type and an id. `layout` contains the arrangement, and `userNodes` contains scripts that
publish topics. The parts that are the same for every experiment are in `layout.json` and
`layout_error.ts`.
"""

import json
from collections.abc import Iterable
from importlib.resources import files
from typing import Any, TypedDict

from tetractl.core.colors import GREY, SLATES, robot_colors
from tetractl.core.setup import Setup
from tetractl.log.format import channels
from tetractl.log.format.scene import WORLD, robot_frame_id

MEDIA_TYPE = "application/json"
VIEW_ASPECT_MIN = 1.1
"""Minimum ratio of the 3D panel's width to its height, for which the view is scaled."""
VIEW_MARGIN = 1.08
"""Visible height, as a multiple of the height of the arena."""
ERROR_TOPIC = "/studio_script/error"
"""Topic on which the viewer's script publishes the errors of the robots."""
TOTAL_COLOR, LIGHT_COLOR = SLATES[1:]
"""Colours of curves that belong to no robot.

The darkest slate, which figures use, would be invisible on the dark background of viewers.
"""

CURVES_MAX = 20
"""Maximum number of robots for which a plot has curves."""

_FILES = files("tetractl.log.format")


class PlotCurve(TypedDict):
    """A curve of a plot: the path of its values in a message, its label and its colour."""

    value: str
    label: str
    color: str


def layout(setup: Setup) -> str:
    """Create the viewer's layout for an experiment as JSON: arena from above, and four plots."""
    template = json.loads((_FILES / "layout.json").read_text())
    period_ns = str(round(setup.period_s * 1e9))
    error_curves = [
        # as `layout_error.ts` publishes it
        PlotCurve(value=f"{ERROR_TOPIC}.total", label="total", color=TOTAL_COLOR),
        *_robot_curves(setup, f"{ERROR_TOPIC}.robots"),
    ]
    cost_curves = [
        PlotCurve(value=f"{channels.STEP}.cost", label="J", color=TOTAL_COLOR),
        PlotCurve(
            value=f"{channels.STEP}.target_cost", label="without obstacles", color=LIGHT_COLOR
        ),
    ]
    time_curves = [
        PlotCurve(value=f"{channels.HOST_TIMING}.solve_ns", label="solve time", color=TOTAL_COLOR),
        PlotCurve(value=period_ns, label="control period", color=GREY),
    ]
    estimate_curves = _robot_curves(setup, f"{channels.STEP}.estimate.a")
    plots = {
        "Plot!error": _plot(template, f"error [{setup.unit}]", error_curves),
        "Plot!cost": _plot(template, f"cost of the plan [{setup.unit}]", cost_curves),
        "Plot!time": _plot(template, "solve time [ns]", time_curves),
        "Plot!estimate": _plot(template, "estimated a [rad/s]", estimate_curves),
    }
    layout_data = template["whole"]
    layout_data["configById"] = {"3D!arena": _view(setup, template["view"]), **plots}
    script = (_FILES / "layout_error.ts").read_text()  # publishes the error of the camera's poses
    script = script.replace("%TARGETS%", json.dumps(setup.targets.tolist()))
    script = script.replace("%STEP%", channels.STEP).replace("%ERROR%", ERROR_TOPIC)
    layout_data["userNodes"]["tetractl-error"]["sourceCode"] = script
    layout_data["layout"]["second"] = _column(list(plots))
    return json.dumps(layout_data, ensure_ascii=False) + "\n"


def _robot_curves(setup: Setup, list_path: str) -> list[PlotCurve]:
    """Create the curves of at most CURVES_MAX robots.

    `list_path` is the path in a message of the list that has a value for each robot.
    """
    colors = robot_colors(setup.names, setup.colors)
    curves = [
        PlotCurve(value=f"{list_path}[{i}]", label=name, color=color)
        for i, (name, color) in enumerate(zip(setup.names, colors, strict=True))
    ]
    return curves[:CURVES_MAX]


def _plot(template: dict[str, Any], title: str, curves: Iterable[PlotCurve]) -> dict[str, Any]:
    """Create a panel of the viewer that plots curves over time."""
    paths = [template["curve"] | curve for curve in curves]
    titles = {"foxglovePanelTitle": title, "lichtblickPanelTitle": title}
    return template["plot"] | titles | {"paths": paths}


def _view(setup: Setup, view: dict[str, Any]) -> dict[str, Any]:
    """Create the panel that shows the arena from above, as large as possible.

    The view is orthographic. Its camera is always `far` / 2 above the plane, and its `distance` is
    the visible height [m], so that an arena of 5 mm fills the panel too. `near` and `far` are
    scaled by the same factor, since a depth buffer has 24 bits.
    """
    arena = setup.arena
    height = VIEW_MARGIN * max(arena.height, arena.width / VIEW_ASPECT_MIN) * setup.metres
    middle_x = (arena.left + arena.right) / 2 * setup.metres
    middle_y = (arena.bottom + arena.top) / 2 * setup.metres
    centre = [middle_x, middle_y, 0]
    frames = [WORLD, *map(robot_frame_id, setup.names)]
    near_far = {"near": height / 100, "far": height * 100}
    view["cameraState"] |= {"distance": height, "targetOffset": centre, **near_far}
    view["scene"]["transforms"]["axisScale"] = height / 20
    view["transforms"] = {f"frame:{frame}": {"visible": False} for frame in frames}
    return view


def _column(panels: list[str]) -> Any:
    """Arrange panels of the viewer in a column, all of equal height."""
    if len(panels) == 1:
        return panels[0]
    return {
        "direction": "column",
        "first": panels[0],
        "second": _column(panels[1:]),
        "splitPercentage": round(100 / len(panels), 2),
    }

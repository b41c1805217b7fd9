"""The layout in which Lichtblick and Foxglove show a trial, as JSON that they import from a file.

The format is that of Lichtblick's `LayoutData`: `configById` contains the settings of each panel,
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
from tetractl.log.format.scene import WORLD, frame_of

MEDIA_TYPE = "application/json"
ASPECT = 1.1
"""Minimum ratio of the 3D panel's width to its height, for which the view is scaled."""
MARGIN = 1.08
ERROR = "/studio_script/error"
WHOLE, LIGHT = SLATES[1:]
"""Colours of what belongs to no robot. The darkest slate, that of figures, is lost on the dark
background of viewers."""

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
    parts = json.loads((_FILES / "layout.json").read_text())
    period_ns = str(round(setup.period_s * 1e9))
    error = [
        # as `layout_error.ts` publishes it
        PlotCurve(value=f"{ERROR}.total", label="total", color=WHOLE),
        *_robot_curves(setup, f"{ERROR}.robots"),
    ]
    cost = [
        PlotCurve(value=f"{channels.STEP}.cost", label="J", color=WHOLE),
        PlotCurve(value=f"{channels.STEP}.target_cost", label="without obstacles", color=LIGHT),
    ]
    time = [
        PlotCurve(value=f"{channels.HOST_TIMING}.solve_ns", label="solve time", color=WHOLE),
        PlotCurve(value=period_ns, label="control period", color=GREY),
    ]
    estimate = _robot_curves(setup, f"{channels.STEP}.estimate.a")
    plots = {
        "Plot!error": _plot(parts, f"error [{setup.unit}]", error),
        "Plot!cost": _plot(parts, f"cost of the plan [{setup.unit}]", cost),
        "Plot!time": _plot(parts, "solve time [ns]", time),
        "Plot!estimate": _plot(parts, "estimated a [rad/s]", estimate),
    }
    window = parts["whole"]
    window["configById"] = {"3D!arena": _view(setup, parts["view"]), **plots}
    script = (_FILES / "layout_error.ts").read_text()  # publishes the error of the camera's poses
    script = script.replace("%TARGETS%", json.dumps(setup.targets.tolist()))
    script = script.replace("%STEP%", channels.STEP).replace("%ERROR%", ERROR)
    window["userNodes"]["tetractl-error"]["sourceCode"] = script
    window["layout"]["second"] = _column(list(plots))
    return json.dumps(window, ensure_ascii=False) + "\n"


def _robot_curves(setup: Setup, values: str) -> list[PlotCurve]:
    """Create the curves of at most CURVES_MAX robots, given the list that has a value per robot."""
    colors = robot_colors(setup.names, setup.colors)
    curves = [
        PlotCurve(value=f"{values}[{i}]", label=name, color=color)
        for i, (name, color) in enumerate(zip(setup.names, colors, strict=True))
    ]
    return curves[:CURVES_MAX]


def _plot(parts: dict[str, Any], title: str, curves: Iterable[PlotCurve]) -> dict[str, Any]:
    """Create a panel of the viewer that plots curves over time."""
    paths = [parts["curve"] | curve for curve in curves]
    titles = {"foxglovePanelTitle": title, "lichtblickPanelTitle": title}
    return parts["plot"] | titles | {"paths": paths}


def _view(setup: Setup, view: dict[str, Any]) -> dict[str, Any]:
    """Create the panel that shows the arena from above, as large as possible.

    The view is orthographic. Its camera is always `far` / 2 above the plane, and its `distance` is
    the visible height [m], so that an arena of 5 mm fills the panel too. `near` and `far` are
    scaled by the same factor, since a depth buffer has 24 bits.
    """
    arena = setup.arena
    height = MARGIN * max(arena.height, arena.width / ASPECT) * setup.metres
    middle_x = (arena.left + arena.right) / 2 * setup.metres
    middle_y = (arena.bottom + arena.top) / 2 * setup.metres
    centre = [middle_x, middle_y, 0]
    frames = [WORLD, *map(frame_of, setup.names)]
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

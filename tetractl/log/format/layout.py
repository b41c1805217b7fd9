"""The layout in which Lichtblick and Foxglove show a trial, as JSON that they import from a file.

The format is that of Lichtblick's `LayoutData`: `configById` holds a panel's settings by its type
and an id, `layout` the arrangement, `userNodes` scripts that publish topics. The parts that are the
same for every experiment are in `layout.json` and `layout_error.ts`.
"""

import json
from importlib.resources import files
from typing import Any

from tetractl.core.colors import GREY, SLATES, robot_colors
from tetractl.core.setup import Setup
from tetractl.log.format import channels
from tetractl.log.format.scene import WORLD, frame_of

MEDIA_TYPE = "application/json"
ASPECT = 1.1
"""Least ratio of the 3D panel's width to its height."""
MARGIN = 1.08
ERROR = "/studio_script/error"
WHOLE, LIGHT = SLATES[1:]
"""Colours of what belongs to no robot. The darkest slate, that of figures, is lost on the dark
background of viewers."""

_FILES = files("tetractl.log.format")


def layout(setup: Setup) -> str:
    """Return the layout for an experiment: the arena from above, and plots of four quantities."""
    robots = range(min(len(setup.names), 20))  # largest number of robots with curves
    curves = list(zip(robots, setup.names, robot_colors(setup.names, setup.colors), strict=False))
    step, timing = channels.STEP, channels.HOST_TIMING
    parts = json.loads((_FILES / "layout.json").read_text())

    def plot(title: str, *curves: tuple[str, str, str]) -> dict[str, Any]:
        """Return a panel of curves; each is given by the path of its values, its label and its
        colour.
        """
        keys = ("value", "label", "color")
        paths = [parts["curve"] | dict(zip(keys, curve, strict=True)) for curve in curves]
        titles = dict.fromkeys(("foxglovePanelTitle", "lichtblickPanelTitle"), title)
        return parts["plot"] | titles | {"paths": paths}

    panels = {
        "3D!arena": _view(setup, parts["view"]),
        "Plot!error": plot(
            f"error [{setup.unit}]",
            (f"{ERROR}.total", "total", WHOLE),
            *((f"{ERROR}.robots[{i}]", name, color) for i, name, color in curves),
        ),
        "Plot!cost": plot(
            f"cost of the plan [{setup.unit}]",
            (f"{step}.cost", "J", WHOLE),
            (f"{step}.target_cost", "without obstacles", LIGHT),
        ),
        "Plot!time": plot(
            "solve time [ns]",
            (f"{timing}.solve_ns", "solve time", WHOLE),
            (str(round(setup.period_s * 1e9)), "control period", GREY),
        ),
        "Plot!estimate": plot(
            "estimated a [rad/s]",
            *((f"{step}.estimate.a[{i}]", name, color) for i, name, color in curves),
        ),
    }
    plots = [name for name in panels if name.startswith("Plot")]
    script = (_FILES / "layout_error.ts").read_text()
    targets = json.dumps(setup.targets.tolist())
    for mark, text in (("%TARGETS%", targets), ("%STEP%", step), ("%ERROR%", ERROR)):
        script = script.replace(mark, text)
    whole = parts["whole"]
    whole["configById"] = panels
    whole["userNodes"]["tetractl-error"]["sourceCode"] = script
    whole["layout"]["second"] = _column(plots)
    return json.dumps(whole, ensure_ascii=False) + "\n"


def _view(setup: Setup, view: dict[str, Any]) -> dict[str, Any]:
    """Return the 3D panel: an orthographic view from above, with the arena as large as possible.

    An orthographic camera is always `far` / 2 above the plane, and its `distance` is the visible
    height [m], so that an arena of 5 mm fills the panel too. `near` and `far` are scaled by the
    same factor, since a depth buffer has 24 bits.
    """
    arena, metres = setup.arena, setup.metres
    height = MARGIN * max(arena.height, arena.width / ASPECT) * metres
    centre = [(arena.left + arena.right) / 2 * metres, (arena.bottom + arena.top) / 2 * metres, 0]
    frames = [WORLD, *map(frame_of, setup.names)]
    near_far = {"near": height / 100, "far": height * 100}
    view["cameraState"] |= {"distance": height, "targetOffset": centre, **near_far}
    view["scene"]["transforms"]["axisScale"] = height / 20
    view["transforms"] = {f"frame:{frame}": {"visible": False} for frame in frames}
    return view


def _column(panels: list[str]) -> Any:
    """Return panels of equal height, one below the other."""
    if len(panels) == 1:
        return panels[0]
    return {
        "direction": "column",
        "first": panels[0],
        "second": _column(panels[1:]),
        "splitPercentage": round(100 / len(panels), 2),
    }

"""The layout in which Lichtblick and Foxglove show a trial, as JSON for their import from a file.

The format is that of Lichtblick's `LayoutData`: `configById` holds a panel's settings by its type
and an id, `layout` the arrangement, `userNodes` scripts whose outputs are topics like others.
"""

import json
from typing import Any

from tetractl.core.colors import robot_colors
from tetractl.core.setup import Setup
from tetractl.log.format import channels
from tetractl.log.format.scene import WORLD, frame_of

MEDIA_TYPE = "application/json"
ASPECT = 1.1
"""Least ratio of the 3D panel's width to its height."""
MARGIN = 1.08
ERROR = "/studio_script/error"
MOST_CURVES = 20

_SCRIPT = """\
import { Input } from "./types";

type Output = { total: number; robots: number[] };

// The targets, in the unit of the spec.
const targets = %TARGETS%;

export const inputs = ["%STEP%"];
export const output = "%ERROR%";

export default function script(event: Input<"%STEP%">): Output {
  const seen = event.message.observation as unknown as { x: number[]; y: number[] };
  const robots = targets.map(([x, y], i) => Math.hypot(seen.x[i] - x, seen.y[i] - y));
  return { total: robots.reduce((sum, error) => sum + error, 0), robots };
}
"""


def layout(setup: Setup) -> str:
    """Return the layout for an experiment: the arena from above, and plots of four quantities."""
    robots = range(min(len(setup.names), MOST_CURVES))
    curves = list(zip(robots, setup.names, robot_colors(setup.names, setup.colors), strict=False))
    step, timing, estimate = channels.STEP, channels.HOST_TIMING, channels.ESTIMATE
    panels = {
        "3D!arena": _view(setup),
        "Plot!error": _plot(
            f"error [{setup.unit}]",
            [
                _curve(f"{ERROR}.total", "total", "#888888"),
                *(_curve(f"{ERROR}.robots[{i}]", name, color) for i, name, color in curves),
            ],
        ),
        "Plot!cost": _plot(
            f"cost of the plan [{setup.unit}]",
            [
                _curve(f"{step}.cost", "J", "#0072B2"),
                _curve(f"{step}.target_cost", "without obstacles", "#888888"),
            ],
        ),
        "Plot!time": _plot(
            "solve time [ns]",
            [
                _curve(f"{timing}.solve_ns", "solve time", "#0072B2"),
                _curve(str(round(setup.period_s * 1e9)), "control period", "#B00020"),
            ],
        ),
        "Plot!estimate": _plot(
            "estimated a [rad/s]",
            [_curve(f"{estimate}.a[{i}]", name, color) for i, name, color in curves],
        ),
    }
    plots = [name for name in panels if name.startswith("Plot")]
    script = (
        _SCRIPT.replace("%TARGETS%", json.dumps(setup.targets.tolist()))
        .replace("%STEP%", channels.STEP)
        .replace("%ERROR%", ERROR)
    )
    whole = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {"tetractl-error": {"name": "error", "sourceCode": script}},
        "playbackConfig": {"speed": 1},
        "layout": {
            "direction": "row",
            "first": "3D!arena",
            "second": _column(plots),
            "splitPercentage": 60,
        },
    }
    return json.dumps(whole, ensure_ascii=False) + "\n"


def _view(setup: Setup) -> dict[str, Any]:
    """Return the 3D panel: an orthographic view from above, with the arena as large as possible.

    An orthographic camera is always `far` / 2 above the plane, and its `distance` is the visible
    height [m], so that a field of 5 mm fills the panel too. `near` and `far` are scaled alike,
    since a depth buffer has 24 bits.
    """
    arena, metres = setup.arena, setup.metres
    height = MARGIN * max(arena.height, arena.width / ASPECT) * metres
    centre = [(arena.left + arena.right) / 2 * metres, (arena.bottom + arena.top) / 2 * metres, 0]
    frames = [WORLD, *map(frame_of, setup.names)]
    return {
        "cameraState": {
            "distance": height,
            "perspective": False,
            "phi": 0,
            "thetaOffset": 0,
            "target": [0, 0, 0],
            "targetOffset": centre,
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45,
            "near": height / 100,
            "far": height * 100,
        },
        "followMode": "follow-none",
        "followTf": WORLD,
        "scene": {"transforms": {"axisScale": height / 20, "showLabel": False}},
        "transforms": {f"frame:{frame}": {"visible": False} for frame in frames},
        "topics": {
            channels.SCENE: {"visible": True},
            channels.SCENE_PLAN: {"visible": True},
        },
        "layers": {},
        "publish": {},
        "imageMode": {},
    }


def _plot(title: str, curves: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "foxglovePanelTitle": title,
        "lichtblickPanelTitle": title,
        "paths": curves,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": False,
        "isSynced": True,
        "xAxisVal": "timestamp",
        "sidebarDimension": 240,
    }


def _curve(path: str, label: str, color: str) -> dict[str, Any]:
    return {
        "value": path,
        "label": label,
        "color": color,
        "enabled": True,
        "timestampMethod": "receiveTime",
    }


def _column(panels: list[str]) -> Any:
    """Return panels stacked vertically with the same height."""
    if len(panels) == 1:
        return panels[0]
    return {
        "direction": "column",
        "first": panels[0],
        "second": _column(panels[1:]),
        "splitPercentage": round(100 / len(panels), 2),
    }

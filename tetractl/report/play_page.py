"""Creates the game in a browser: one HTML file in which a person steers the robots of a spec.

The page moves the robots by the spec's own model (`assets/motion.js`), without disturbances. It
contains one trial of the spec's controller, which it plays after the person's, for comparison.
"""

import json
from html import escape
from typing import Any

from tetractl.core.colors import robot_colors
from tetractl.core.errors import UsageError, format_unit
from tetractl.core.setup import Setup
from tetractl.log.read.trial_log import TrialLog
from tetractl.plant.sim_section import SimSection
from tetractl.report.html_page import THEME, FramedPage, asset, html_page, script_json
from tetractl.report.trial_data import pack_trial, trial_data
from tetractl.spec.loaded_spec import LoadedSpec
from tetractl.tools.table.table import pluralize

SCRIPTS = ("data.js", "clock.js", "legend.js", "scene.js", "motion.js", "play.js")
"""The scripts of the page, in the order in which they need each other."""
KNOWN_MOTIONS = ("exact", "euler")
"""The motions that `assets/motion.js` knows."""
TRIAL_CHARACTERS_MAX = 120_000
"""Maximum size of the controller's trial on the page [characters].

A longer trial loses its plans, so that the page stays below 300 kB.
"""
FRAME_PX = 1000
"""Height of the page in a notebook [pixels]."""


def play_page(spec: LoadedSpec, log: TrialLog) -> FramedPage:
    """Create the page on which a person steers the robots of a spec.

    Args:
        spec: A spec without disturbances, by `undisturbed_spec`, whose motion the page knows.
        log: A trial of the spec's controller.
    """
    experiment = spec.experiment
    world = json.dumps(_world(spec), ensure_ascii=False, allow_nan=False)
    trial = pack_trial(_controllers_trial(log))
    body = (
        f"<header><h1>Play: {escape(experiment.name)}</h1>{THEME}</header>{asset('play.html')}"
        f'<script type="application/json" id="world">{script_json(world)}</script>\n'
        f'<script type="text/plain" id="trial-data-0">{trial}</script>\n'
    )
    return FramedPage(html_page(f"Play: {experiment.name}", body, SCRIPTS), FRAME_PX)


def refuse_unknown_motion(spec: LoadedSpec) -> None:
    """Check that the page can move the robots of a spec without disturbances.

    Raises:
        UsageError: If they move by a motion that the page does not know.
    """
    plant = spec.experiment.plant
    motion = plant.motion if isinstance(plant, SimSection) else plant.type
    if motion not in KNOWN_MOTIONS:
        raise UsageError(
            f"a web page cannot simulate the motion '{motion}'",
            f"a page can simulate {' and '.join(KNOWN_MOTIONS)}: give --set plant.motion=exact",
        )


def _controllers_trial(log: TrialLog) -> dict[str, Any]:
    """Return the data of the controller's trial for the page, without its history.

    The plans are None if the compressed data would otherwise exceed TRIAL_CHARACTERS_MAX.
    """
    data = trial_data(log, log.origin) | {"history": None}
    if len(pack_trial(data)) > TRIAL_CHARACTERS_MAX:
        data["plan"] = None
    return data


def _world(spec: LoadedSpec) -> dict[str, Any]:
    """Return the experiment as data for the page, with lengths in its unit."""
    experiment = spec.experiment
    plant = experiment.plant
    assert isinstance(plant, SimSection), "a spec without disturbances is simulated"
    setup = experiment.setup
    arena = setup.arena
    control = experiment.controller
    return {
        "motion": plant.motion,
        "unit": format_unit(setup.unit),
        "period": setup.period_s,
        "limit": control.time_limit,
        "tolerance": control.arrival_tolerance,
        "arena": [arena.left, arena.bottom, arena.right, arena.top],
        "obstacles": [shape.outline().tolist() for shape in setup.obstacles],
        "shapes": [
            {"corners": shape.corners.tolist(), "radius": shape.radius} for shape in setup.obstacles
        ],
        "robots": _robots(setup),
        "task": _task(setup),
    }


def _robots(setup: Setup) -> list[dict[str, Any]]:
    """Return each robot as data for the page, with lengths in the experiment's unit.

    Starts are x, y and heading [rad]. The list of via points is always empty.
    """
    colors = robot_colors(setup.names, setup.colors)
    starts = setup.starts.array().tolist()
    return [
        {
            "name": name,
            "color": colors[i],
            "start": starts[i],
            "target": setup.targets[i].tolist(),
            "via": [],
            "a": float(setup.a[i]),
            "speed": float(setup.speed[i]),
        }
        for i, name in enumerate(setup.names)
    ]


def _task(setup: Setup) -> str:
    """Describe in words what the person has to do."""
    around = ""
    if setup.obstacles:
        around = f", around the yellow {pluralize('obstacle', len(setup.obstacles))}"
    count = len(setup.names)
    if count == 1:
        return (
            f"Steer the robot to the square with its letter{around}. It turns to the direction that"
            " you give while it drives."
        )
    return (
        f"Steer {count} robots with one direction: all of them receive it, and each turns to it at"
        f" its own rate. Bring each one to the square with its letter{around}."
    )

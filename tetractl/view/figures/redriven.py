"""Paths of a recorded trial and of its commands driven again, and the distances between them."""

import numpy as np
from matplotlib.figure import Figure

from tetractl.core.colors import robot_colors
from tetractl.core.text import unit_of
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.player import tracked
from tetractl.replay.redrive import Apart
from tetractl.view import style


def redriven_figure(recorded: TrialLog, again: TrialLog, apart: Apart) -> Figure:
    """Draw both paths of each robot, recorded ones solid, and their distances over time."""
    setup = recorded.start.setup
    unit = unit_of(setup.unit)
    colors = robot_colors(setup.names, setup.colors)
    with style.styled():
        figure = style.figure(style.PAGE_IN, 3.4)
        paths, over_time = figure.subplots(1, 2)
        for log, line, what in ((recorded, "-", "recorded"), (again, "--", "driven again")):
            since = log.mocap_ns >= log.began_ns
            xy = tracked(log.mocap, log.valid)[since]
            for robot, color in enumerate(colors):
                paths.plot(*xy[:, robot].T, line, color=color, lw=1.1)
            label = f"{what}, {log.origin.value}"
            paths.plot([], [], line, color=style.INK, lw=1.1, label=label)
        for shape in setup.obstacles:
            paths.fill(*shape.outline().T, fc=style.OBSTACLE, ec=style.OBSTACLE_EDGE, lw=0.6)
        paths.set_aspect("equal", adjustable="datalim")
        paths.set_xlabel(f"x [{unit}]")
        paths.set_ylabel(f"y [{unit}]")
        for robot, (name, color) in enumerate(zip(setup.names, colors, strict=True)):
            values = apart.distance[:, robot]
            over_time.plot(apart.time_s, values, color=color, lw=1.1, label=name)
        over_time.set_ylim(0, max(float(np.nanmax(apart.distance, initial=0.0)) * 1.04, 1e-9))
        over_time.set_xlabel("time since the first command [s]")
        over_time.set_ylabel(f"distance [{unit}]")
        style.panel(paths, "a", "paths")
        style.panel(over_time, "b", "between the two paths of a robot")
        figure.legend(loc="outside lower center", ncols=6)
    return figure

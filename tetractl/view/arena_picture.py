"""A picture of a trial that still runs: the arena, obstacles, targets and the ways so far."""

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tetractl.core.colors import robot_colors
from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.view.figures.trajectory import draw_scene

LONGER_SIDE_IN = 5.0
"""Width or height of the picture, whichever is larger [inches]."""
PIXELS_PER_INCH = 100


def arena_picture(setup: Setup, ways: Floats) -> NDArray[np.uint8]:
    """Return a picture (H, W, 3) of the arena with the robots' places so far, `ways` (M, N, 2)."""
    arena = setup.arena
    scale = LONGER_SIDE_IN / max(arena.width, arena.height)
    size_in = scale * arena.width, scale * arena.height
    figure = Figure(size_in, PIXELS_PER_INCH, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    colors = robot_colors(setup.names, setup.colors)
    draw_scene(axes, [setup], colors, [ways])
    axes.set(xlim=(arena.left, arena.right), ylim=(arena.bottom, arena.top))
    for robot, color in enumerate(colors):
        axes.plot(*ways[:, robot].T, color=color, lw=1.3)
        axes.plot(*ways[-1, robot], "o", color=color, ms=6)
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3]

"""Draws the particle swarm of a search at three iterations, as in Figure 2 of the paper by Ou."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Patch

from tetractl.core.errors import format_unit
from tetractl.core.poses import Floats
from tetractl.log.read.trial_log import TrialLog
from tetractl.view import style
from tetractl.view.figures.trials import one_trial, require_steps
from tetractl_papers.swarm_history import SwarmHistory, repeat_first_search

N_SHADES = 10
"""Number of grey levels for the cost J. Each level covers the same fraction of the image.

If the levels were spread evenly over J, nearly all would show the few signals that lead into an
obstacle.
"""


HEIGHT_IN = 3.1
"""Height of the figure [in]."""
SHOWN_FRACTIONS = (0.0, 0.25, 1.0)
"""The iterations that the panels show, each as a fraction of all iterations."""
SMALL_DOTS_ABOVE_PARTICLES = 200
"""Maximum number of particles that are drawn as large dots."""
AXIS_LIMIT_RAD = 1.04 * np.pi
"""Limit of the axes [rad]. It is slightly above pi, so that dots at the edge are drawn whole."""


@style.styled()
def swarm_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the particle swarm of a trial's first search, at three iterations (Figure 2).

    The axes are the first two signals of the sequence. The background shows the cost J as a
    function of these two signals, while all other signals are taken from the best sequence found.
    The last panel also shows the path of one particle, and the best point that this particle found.

    Args:
        logs: Exactly one log, of a trial with at least one step.
    """
    log = one_trial(logs)
    require_steps(log)
    history = repeat_first_search(log, SHOWN_FRACTIONS)
    unit = format_unit(log.start.setup.unit)
    figure = style.figure(style.PAGE_IN, HEIGHT_IN)
    (panels,) = figure.subplots(1, len(history.frames), sharex=True, sharey=True, squeeze=False)
    shades = [_draw_cost_shades(axes, history) for axes in panels]
    for axes, letter, frame in zip(panels, "abc", history.frames, strict=False):
        size = 4 if len(frame.particles) <= SMALL_DOTS_ABOVE_PARTICLES else 2
        _draw_dots(axes, frame.particles, style.SLATES[1], size, mew=0.3, zorder=2, gid="swarm")
        _draw_dots(axes, frame.best, style.INK, 8, mew=0.8, marker="*", zorder=5, gid="best")
        title = f"iteration {frame.z}, J {frame.cost:.3g} {unit}"
        style.panel(axes, letter, title, "signal $u_1$ [rad]")
    panels[0].set_ylabel("signal $u_2$ [rad]")
    _draw_particle_path(panels[-1], history)
    bar = figure.colorbar(
        shades[0], ax=panels.tolist(), pad=0.01, aspect=30,
        format=lambda cost, _: f"{float(f'{cost:.3g}'):g}",
    )  # fmt: skip
    bar.set_label(f"$J$ over $u_1$ and $u_2$ [{unit}]")
    bar.ax.spines["outline"].set_visible(False)
    _draw_legend(figure, history, log.steps[0].plan.search.length)
    return figure


def _draw_particle_path(axes: Axes, history: SwarmHistory) -> None:
    """Draw the path of one particle, and the best point that this particle found."""
    u_1, u_2 = history.path.T
    axes.plot(u_1, u_2, "-", color=style.INK, lw=0.5, alpha=0.6, zorder=3)
    axes.plot(u_1, u_2, "o", color=style.INK, ms=1.8, zorder=3, gid="course")
    _draw_dots(axes, history.path_best, style.INK, 6, mew=0.6, marker="D", zorder=4)


def _draw_legend(figure: Figure, history: SwarmHistory, n_signals: int) -> None:
    """Draw the legend, which also reports whether the repeated search has the logged costs J."""
    n_particles = len(history.frames[0].particles)
    rounding = "as logged" if history.repeated else "differs from the log by rounding"
    dot_look: dict[str, Any] = {"marker": "o", "mec": "white"}
    legend_entries = [
        style.sign(f"{n_particles} particles", color=style.SLATES[1], ms=4, **dot_look),
        style.sign("best of all, $u_{gb}$", color=style.INK, ms=8, marker="*", mec="white"),
        style.sign("one particle's course", color=style.INK, ms=2.5, **dot_look),
        style.sign("its own best, $u_{lb}$", color=style.INK, ms=6, marker="D", mec="white"),
        Patch(color="none", label=f"first plan, {n_signals} signals; J {rounding}"),
    ]
    style.legend(figure, legend_entries)


def _draw_dots(axes: Axes, points: Floats, color: str, size: float, **look: Any) -> None:
    """Draw dots at points, shape (n, 2), or one dot at a point, shape (2,)."""
    whole_look = {"ls": "none", "marker": "o", **look}
    axes.plot(*points.T, ms=size, color=color, mec="white", **whole_look)


def _draw_cost_shades(axes: Axes, history: SwarmHistory) -> AxesImage:
    """Draw the cost J over the two signals as an image, with lower J in lighter grey.

    Each of N_SHADES shades covers the same number of grid points.
    """
    quantiles = np.linspace(0, 1, N_SHADES + 1)
    levels = np.unique(np.quantile(history.costs, quantiles))
    if len(levels) < 2:
        levels = np.array([levels[0], levels[0] + 1])
    image = axes.imshow(
        history.costs,
        origin="lower",
        extent=(-np.pi, np.pi, -np.pi, np.pi),
        cmap="Greys",
        norm=BoundaryNorm(levels.tolist(), 256),
        alpha=0.55,
        interpolation="nearest",
        zorder=0,
    )
    axes.set(xlim=(-AXIS_LIMIT_RAD, AXIS_LIMIT_RAD), ylim=(-AXIS_LIMIT_RAD, AXIS_LIMIT_RAD))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_ticks([-np.pi, 0, np.pi], ["−π", "0", "π"])
    return image

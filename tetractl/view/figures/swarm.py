"""The paper's Figure 2: a search's particles, each at the first two signals of its sequence."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from tetractl.core.errors import unit_of
from tetractl.core.poses import Floats
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.swarm_history import SwarmHistory, first_swarm
from tetractl.view import style
from tetractl.view.figures.axes import need_steps, one_trial

SHADES = 10
"""Number of greys of J: each covers the same share of the square. Spread evenly over J, they would
nearly all fall to the few signals that lead into an obstacle."""


@style.styled()
def swarm_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the particle swarm of the first plan's search at three iterations.

    The axes are the first two signals of the sequence. The background shows the cost J as a
    function of these two; the other signals are those of the best sequence found. The last panel
    shows the path of one particle, and its own best point at the end.
    """
    log = one_trial(logs)
    need_steps(log)
    history = first_swarm(log, (0.0, 0.25, 1.0))  # of the iterations
    unit = unit_of(log.start.setup.unit)
    figure = style.figure(style.PAGE_IN, 3.1)
    (panels,) = figure.subplots(1, len(history.frames), sharex=True, sharey=True, squeeze=False)
    shades = [_shades(axes, history) for axes in panels]
    for axes, letter, frame in zip(panels, "abc", history.frames, strict=False):
        size = 4 if len(frame.particles) <= 200 else 2
        _dots(axes, frame.particles, style.SLATES[1], size, mew=0.3, zorder=2, gid="swarm")
        _dots(axes, frame.best, style.INK, 8, mew=0.8, marker="*", zorder=5, gid="best")
        title = f"iteration {frame.z}, J {frame.cost:.3g} {unit}"
        style.panel(axes, letter, title, "signal $u_1$ [rad]")
    panels[0].set_ylabel("signal $u_2$ [rad]")
    panels[-1].plot(*history.path.T, "-", color=style.INK, lw=0.5, alpha=0.6, zorder=3)
    panels[-1].plot(*history.path.T, "o", color=style.INK, ms=1.8, zorder=3, gid="course")
    _dots(panels[-1], history.path_best, style.INK, 6, mew=0.6, marker="D", zorder=4)
    bar = figure.colorbar(
        shades[0],
        ax=panels.tolist(),
        pad=0.01,
        aspect=30,
        format=lambda cost, _: f"{float(f'{cost:.3g}'):g}",
    )
    bar.set_label(f"$J$ over $u_1$ and $u_2$ [{unit}]")
    bar.ax.spines["outline"].set_visible(False)
    marker: dict[str, Any] = {"marker": "o", "mec": "white"}
    again = "as logged" if history.repeated else "differs from the log by rounding"
    search = log.steps[0].plan.search
    signs = [
        style.sign(
            f"{len(history.frames[0].particles)} particles", color=style.SLATES[1], ms=4, **marker
        ),
        style.sign("best of all, $u_{gb}$", color=style.INK, ms=8, marker="*", mec="white"),
        style.sign("one particle's course", color=style.INK, ms=2.5, **marker),
        style.sign("its own best, $u_{lb}$", color=style.INK, ms=6, marker="D", mec="white"),
        Patch(color="none", label=f"first plan, {search.length} signals; J {again}"),
    ]
    style.legend(figure, signs)
    return figure


def _dots(axes: Axes, at: Floats, color: str, size: float, **look: Any) -> None:
    """Draw dots at points (n, 2) or at one point (2,)."""
    axes.plot(*at.T, ms=size, color=color, mec="white", **{"ls": "none", "marker": "o", **look})


def _shades(axes: Axes, history: SwarmHistory):
    """Draw J over the two signals as an image, lighter for a lower J; return the image."""
    levels = np.unique(np.quantile(history.costs, np.linspace(0, 1, SHADES + 1)))
    if len(levels) < 2:
        levels = np.array([levels[0], levels[0] + 1])
    shades = axes.imshow(
        history.costs, origin="lower", extent=(-np.pi, np.pi, -np.pi, np.pi), cmap="Greys",
        norm=BoundaryNorm(levels.tolist(), 256), alpha=0.55,
        interpolation="nearest", zorder=0,
    )  # fmt: skip
    limits = (-np.pi * 1.04, np.pi * 1.04)
    ticks = {"ticks": [-np.pi, 0, np.pi], "labels": ["−π", "0", "π"]}
    axes.set(xlim=limits, ylim=limits)
    axes.set_xticks(**ticks)
    axes.set_yticks(**ticks)
    return shades

"""The paper's Figure 2: a search's particles, each at the first two signals of its sequence."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from tetractl.core.colors import BLUE, GREEN
from tetractl.core.errors import unit_of
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.swarm_history import Frame, SwarmHistory, first_swarm
from tetractl.view import style
from tetractl.view.figures.axes import need_steps, one_trial

PURPLE = "#7A3E9D"
SHARES = (0.0, 0.25, 1.0)
"""Iterations that are shown, as fractions of the search's iterations."""


def swarm_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the particle swarm of the first plan's search at three iterations.

    The axes are the first two signals of the sequence. The background shows the cost J as a
    function of these two; the other signals are those of the best sequence found. The last panel
    shows the path of one particle.
    """
    log = one_trial(logs)
    need_steps(log)
    history = first_swarm(log, SHARES)
    unit = unit_of(log.start.setup.unit)
    with style.styled():
        figure = style.figure(style.PAGE_IN, 3.1)
        panels = figure.subplots(1, len(history.frames), sharex=True, sharey=True, squeeze=False)
        shades = [_shades(axes, history) for axes in panels[0]]
        for axes, letter, frame in zip(panels[0], "abc", history.frames, strict=False):
            _swarm(axes, frame)
            style.panel(axes, letter, f"iteration {frame.z}, J {frame.cost:.3g} {unit}")
            axes.set_xlabel("signal $u_1$ [rad]")
        panels[0, 0].set_ylabel("signal $u_2$ [rad]")
        _course(panels[0, -1], history)
        bar = figure.colorbar(shades[0], ax=panels[0].tolist(), pad=0.01, aspect=30)
        bar.set_label(f"$J$ over $u_1$ and $u_2$ [{unit}]")
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
        figure.legend(handles=_key(log, history), loc="outside lower center", ncols=3)
    return figure


def _shades(axes: Axes, history: SwarmHistory):
    """Draw J over the two signals as an image, lighter for a lower J; return the image."""
    least, most = float(history.costs.min()), float(np.percentile(history.costs, 98))
    scale = Normalize(least, most if most > least else least + 1)
    shades = axes.imshow(
        history.costs,
        origin="lower",
        extent=(-np.pi, np.pi, -np.pi, np.pi),
        cmap="Greys",
        norm=scale,
        alpha=0.55,
        interpolation="nearest",
        zorder=0,
    )
    marks = np.array([-np.pi, 0, np.pi])
    axes.set_xticks(marks, ["−π", "0", "π"])
    axes.set_yticks(marks, ["−π", "0", "π"])
    axes.set_xlim(-np.pi * 1.04, np.pi * 1.04)
    axes.set_ylim(-np.pi * 1.04, np.pi * 1.04)
    return shades


def _swarm(axes: Axes, frame: Frame) -> None:
    size = 4 if len(frame.particles) <= 200 else 2
    axes.plot(
        *frame.particles.T, "o", ms=size, color=GREEN, mec="white", mew=0.3, zorder=2, gid="swarm"
    )
    axes.plot(*frame.best, "o", ms=7, color=BLUE, mec="white", mew=0.8, zorder=5, gid="best")


def _course(axes: Axes, history: SwarmHistory) -> None:
    """Draw the path of one particle over the iterations, and its own best point at the end."""
    axes.plot(*history.path.T, "-", color=style.INK, lw=0.5, alpha=0.6, zorder=3)
    axes.plot(*history.path.T, "o", ms=1.8, color=style.INK, zorder=3, gid="course")
    axes.plot(*history.path_best, "o", ms=6, color=PURPLE, mec="white", mew=0.6, zorder=4)


def _key(log: TrialLog, history: SwarmHistory) -> list[Line2D | Patch]:
    def dot(label: str, color: str, size: float) -> Line2D:
        return Line2D([], [], color=color, marker="o", ms=size, mec="white", ls="none", label=label)

    search = log.steps[0].plan.search
    again = "as logged" if history.repeated else "differs from the log by rounding"
    return [
        dot(f"{len(history.frames[0].particles)} particles", GREEN, 4),
        dot("best of all, $u_{gb}$", BLUE, 7),
        dot("one particle's course", style.INK, 2.5),
        dot("its own best, $u_{lb}$", PURPLE, 6),
        Patch(color="none", label=f"first plan, {search.length} signals; J {again}"),
    ]

"""The total errors of several batches over time: the median of each, and where half of it lies."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from tetractl.core.clock import SECOND
from tetractl.core.colors import PALETTE
from tetractl.core.errors import LogError
from tetractl.core.text import unit_of
from tetractl.log.read.trial_log import TrialLog
from tetractl.view import style
from tetractl.view.figures.axes import by_folder
from tetractl.view.figures.errors import POINTS, QUARTILES, errors_at
from tetractl.view.figures.labels import end_labels


def arms_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the median total error of each folder's trials over time, with their middle half.

    A trial that has ended counts with its error at the end; only complete trials count. Batches
    may differ in robots, arena and controller, but not in the length unit.
    """
    batches = by_folder(logs)
    for log in logs:
        if not len(log.mocap_ns):
            raise LogError(f"{log.path}: holds no camera frames to plot")
    unit = unit_of(logs[0].start.setup.unit)
    every = [log for found in batches.values() for log in found]
    end_s = max(1e-9, *(float(log.mocap_ns[-1] - log.began_ns) / SECOND for log in every))
    time_s = np.linspace(0, end_s, POINTS)
    with style.styled():
        figure = style.figure(style.PAGE_IN, 3.3)
        axes = figure.subplots()
        ends, colors = list[float](), list[str]()
        for i, (label, found) in enumerate(batches.items()):
            totals = np.array([errors_at(log, time_s).sum(axis=1) for log in found])
            low, middle, high = np.nanpercentile(totals, QUARTILES, axis=0)
            color = PALETTE[i % len(PALETTE)]
            axes.fill_between(time_s, low, high, color=color, alpha=0.15, lw=0)
            named = f"{label}, n = {len(found)}"
            axes.plot(time_s, middle, color=color, lw=1.3, label=named, gid=f"arm-{i}")
            ends.append(float(middle[-1]))
            colors.append(color)
        axes.set_xlim(0, end_s)
        axes.set_ylim(bottom=0)
        axes.set_xlabel("time since the first command [s]")
        axes.set_ylabel(f"total error, median [{unit}]")
        end_labels(axes, ends, [f"{end:.3g}" for end in ends], colors)
        handles, _ = axes.get_legend_handles_labels()
        handles.append(Patch(color=style.GREY, alpha=0.3, lw=0, label="middle half of the trials"))
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure

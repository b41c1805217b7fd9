"""Figure of the common signal: its direction, and its intensity if the controller chooses it."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from tetractl.core.colors import BLUE
from tetractl.core.poses import wrap
from tetractl.log.read.trial_log import TrialLog
from tetractl.view import style
from tetractl.view.figures.axes import need_steps, one_trial
from tetractl.view.figures.curves import SINCE


@style.styled()
def signal_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the direction and the intensity sent in each control step of a trial, held until the
    next; steps without a direction, in which robots stand, leave a gap.
    """
    log = one_trial(logs)
    need_steps(log)
    times = [log.elapsed_s(step.command.sent_ns) for step in log.steps]
    u = np.array([step.command.direction for step in log.steps], dtype=float)
    shown = [("direction $u$ [rad]", wrap(u), (-np.pi, np.pi))]
    if (of := log.start.setup.intensity) is not None:
        chosen = np.array([step.command.intensity for step in log.steps], dtype=float)
        shown.append((f"{of.name} [{of.unit}]", chosen, (of.low, of.high)))
    figure = style.figure(style.COLUMN_IN, 0.6 + 1.3 * len(shown))
    panels = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (name, values, (low, high)) in zip(panels, shown, strict=True):
        axes.step(times, values, where="post", color=BLUE, lw=1.0)
        room = 0.05 * (high - low)
        axes.set(ylabel=name, ylim=(low - room, high + room))
    panels[-1].set_xlabel(SINCE)
    return figure

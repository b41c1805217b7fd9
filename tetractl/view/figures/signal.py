"""Figure of the common signal: its direction."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from tetractl.core.colors import BLUE
from tetractl.core.poses import wrap
from tetractl.log.read.trial_log import TrialLog
from tetractl.view import style
from tetractl.view.figures.axes import need_steps, one_trial
from tetractl.view.figures.curves import SINCE

MARGIN_RAD = 0.05 * 2 * np.pi
"""Room above and below the directions [rad]."""


@style.styled()
def signal_figure(logs: Sequence[TrialLog]) -> Figure:
    """Draw the direction sent in each control step of a trial, held until the next; steps without
    a direction, in which robots stand, leave a gap.
    """
    log = one_trial(logs)
    need_steps(log)
    times = [log.elapsed_s(step.command.sent_ns) for step in log.steps]
    u = np.array([step.command.direction for step in log.steps], dtype=float)
    figure = style.figure(style.COLUMN_IN, 1.9)
    axes = figure.subplots()
    axes.step(times, wrap(u), where="post", color=BLUE, lw=1.0)
    axes.set(ylabel="direction $u$ [rad]", ylim=(-np.pi - MARGIN_RAD, np.pi + MARGIN_RAD))
    axes.set_xlabel(SINCE)
    return figure

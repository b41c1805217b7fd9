"""What several figures share: one trial of the logs given, and logarithmic axes."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from tetractl.core.errors import LogError, UsageError
from tetractl.core.poses import Floats
from tetractl.log.read.trial_log import TrialLog

LABELLED = 8  # most robots that get a line of the legend each


def one_trial(logs: Sequence[TrialLog]) -> TrialLog:
    """Return the only log; UsageError for several."""
    if len(logs) > 1:
        raise UsageError(
            f"this figure shows one trial, not {len(logs)}",
            "give one log, or use --kind trajectory",
        )
    return logs[0]


def need_steps(log: TrialLog) -> None:
    """Raise LogError for a log without control steps."""
    if not log.steps:
        raise LogError(f"{log.path}: holds no control steps to plot")


def positive(values: Floats) -> Floats:
    """Return values with NaN for those that a logarithmic axis cannot show."""
    values = np.asarray(values, dtype=float)
    return np.where(np.isfinite(values) & (values > 0), values, np.nan)


def span(values: Floats) -> tuple[float, float]:
    """Return the least and largest of positive values, at least 10 % apart."""
    seen = values[np.isfinite(values)]
    if not len(seen):
        return 0.1, 10.0
    low, high = float(seen.min()), float(seen.max())
    return (low, high) if high > 1.1 * low else (low / 1.05, high * 1.05)


def plain_log(axes: Axes) -> None:
    """Write 100 rather than 10^2, and mark 1, 2 and 5 of each decade where there are few."""
    low, high = axes.get_ylim()
    marks = (1.0, 2.0, 5.0) if high / low < 1000 else (1.0,)
    axes.yaxis.set_major_locator(LogLocator(subs=marks))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())

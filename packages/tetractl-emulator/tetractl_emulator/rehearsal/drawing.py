"""The drawing of a rehearsal: how often each fault was met and noticed, and after what time."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from tetractl.view import style
from tetractl_emulator.rehearsal.schedule import FaultRow
from tetractl_emulator.rehearsal.summary import DayRow, Met, met_by_kind

ROW_IN = 0.13


def days_figure(rows: Sequence[DayRow], kinds: Sequence[FaultRow], title: str) -> Figure:
    """Draw a rehearsal: (a) the days on which each fault was met, of these those on which it was
    the only one and those on which the guard noticed it alone; (b) the times until then [s], and
    their median.
    """
    drawing = _drawn(met_by_kind(rows), kinds)
    style.headline(drawing, title)
    return drawing


@style.styled()
def _drawn(met: dict[str, Met], kinds: Sequence[FaultRow]) -> Figure:
    drawing = style.figure(style.PAGE_IN, 0.9 + ROW_IN * len(kinds))
    days, times = drawing.subplots(1, 2, sharey=True, width_ratios=(2, 3))
    rows = np.arange(len(kinds))
    faults = [met.get(kind.name, Met()) for kind in kinds]
    for counts, color, height in (
        ([fault.days for fault in faults], style.FAINT, 0.8),
        ([fault.alone for fault in faults], style.GREY, 0.5),
        ([len(fault.times_s) for fault in faults], style.INK, 0.2),
    ):
        days.barh(rows, counts, height=height, color=color)
    for row, fault in enumerate(faults):
        rows_of_fault = [row] * len(fault.times_s)
        times.plot(fault.times_s, rows_of_fault, "o", color=style.GREY, ms=2, alpha=0.5)
        if fault.times_s:
            times.plot([np.median(fault.times_s)], [row], "|", color=style.INK, ms=7)
    days.set_yticks(rows, [kind.name for kind in kinds])
    days.set_ylim(len(kinds) - 0.5, -0.5)
    if any(time_s > 0 for fault in faults for time_s in fault.times_s):
        times.set_xscale("log")
    style.panel(days, "a", "met, alone, noticed alone", "days")
    style.panel(times, "b", "noticed after", "time from the fault to a hold or an abort [s]")
    signs = [
        style.sign("a day", marker="o", ms=3),
        style.sign("median", marker="|", color=style.INK, ms=7),
    ]
    style.legend(drawing, signs)
    return drawing

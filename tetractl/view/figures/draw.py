"""Draws the figures of `tetractl plot` by name."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from tetractl.core.errors import UsageError
from tetractl.core.registries import CELL_FIGURES, FIGURES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tetractl.log.read.track_log import TrackLog
    from tetractl.log.read.trial_log import TrialLog


def check_kind(kind: str) -> None:
    """Raise UsageError if no figure has this name."""
    if kind not in FIGURES:
        raise UsageError(
            f"no figure is called {kind!r}",
            f"there are {', '.join(FIGURES.names())}, and video for a film",
        )


def draw(kind: str, logs: "Sequence[TrialLog]") -> "Figure":
    """Draw the figure named `kind`; its headline names the plants and counts the incomplete trials.

    Of the built-in figures, only `trajectory`, `errors`, `arms`, `ecdf` and `scatter` show several
    trials.
    """
    from tetractl.view.figures.axes import broken_off
    from tetractl.view.style import headline

    check_kind(kind)
    figure = FIGURES.load(kind)(logs)
    headline(figure, ", ".join(sorted({log.origin.value for log in logs})), broken_off(logs))
    return figure


def draw_cells(kind: str, logs: "Sequence[TrackLog]") -> "Figure":
    """Draw the figure of a film's cells named `kind`; UsageError if there are several films."""
    if kind not in CELL_FIGURES:
        raise UsageError(
            f"no figure of a film's cells is called {kind!r}",
            f"there are {', '.join(CELL_FIGURES.names())}",
        )
    if len(logs) > 1:
        raise UsageError(f"this figure shows one film, not {len(logs)}", "give one log")
    return CELL_FIGURES.load(kind)(logs[0])

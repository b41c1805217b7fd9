"""Draws the figures of a film's cells by name."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from tetractl.core.errors import UsageError
from tetractl_microscope.registries import CELL_FIGURES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tetractl_microscope.film.track_log import TrackLog


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

"""Draws the figures of `tetractl plot` by name."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from tetractl.core.errors import UsageError
from tetractl.core.registries import FIGURES
from tetractl.spec.packages import not_installed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tetractl.log.read.trial_log import TrialLog


def check_kind(kind: str) -> None:
    """Raise UsageError if there is no figure of this name, or if its package is not installed."""
    if kind not in FIGURES:
        lack = not_installed(FIGURES.group, kind)
        if lack is not None:
            why, hint = lack
            raise UsageError(f"{kind}: {why}", hint)
        names = ", ".join(FIGURES.names())
        raise UsageError(
            f"there is no figure named {kind!r}", f"the figures are {names}, and video"
        )


def draw(kind: str, logs: "Sequence[TrialLog]") -> "Figure":
    """Draw the figure named `kind` of trials, with a headline.

    The headline names the plants, which are the simulated or real robots, and counts the incomplete
    trials. Of the built-in figures, only `trajectory`, `errors` and `batch` show several trials.
    """
    from tetractl.view.style import headline

    check_kind(kind)
    figure = FIGURES.load(kind)(logs)
    plants = sorted({log.origin.value for log in logs})
    headline(figure, ", ".join(plants), _broken_off(logs))
    return figure


def _broken_off(logs: "Sequence[TrialLog]") -> str:
    """Return a figure's note on incomplete trials: how a single one ended, or how many there are.

    Empty if all trials are complete.
    """
    from tetractl.view.figures.trials import unfinished

    if len(logs) == 1:
        return unfinished(logs[0])
    cut = sum(1 for log in logs if unfinished(log))
    if not cut:
        return ""
    counted = "" if cut == len(logs) else ", not in the means"
    return f"{cut} of {len(logs)} trials did not run to their end{counted}"

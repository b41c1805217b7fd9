"""Draws the figures of `tetractl plot` by name."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from tetractl.core.errors import UsageError
from tetractl.core.registries import FIGURES
from tetractl.spec.packages import explain_missing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tetractl.log.read.trial_log import TrialLog


def check_kind(kind: str) -> None:
    """Check that there is a figure of this name.

    Raises:
        UsageError: If there is no such figure, or if its package is not installed.
    """
    if kind not in FIGURES:
        missing_package = explain_missing(FIGURES.group, kind)
        if missing_package is not None:
            reason, hint = missing_package
            raise UsageError(f"{kind}: {reason}", hint)
        names = ", ".join(FIGURES.names())
        raise UsageError(
            f"there is no figure named {kind!r}", f"the figures are {names}, and video"
        )


def draw(kind: str, logs: "Sequence[TrialLog]") -> "Figure":
    """Draw a figure of trials by its name, with a headline.

    The headline names the plants, which are the simulated or real robots, and counts the incomplete
    trials. Most built-in figures show a single trial. Only `trajectory`, `errors` and `batch` can
    show several trials.

    Args:
        kind: Name of the figure.
        logs: The trials.

    Raises:
        UsageError: If there is no such figure, if its package is not installed, or if the figure
            cannot show these trials.
    """
    from tetractl.view.style import headline

    check_kind(kind)
    figure = FIGURES.load(kind)(logs)
    plants = sorted({log.origin.value for log in logs})
    headline(figure, ", ".join(plants), _note_on_incomplete(logs))
    return figure


def _note_on_incomplete(logs: "Sequence[TrialLog]") -> str:
    """Describe the incomplete trials of a figure for its headline.

    The text says how a single trial ended, or how many trials are incomplete. It is empty if all
    trials are complete.
    """
    from tetractl.view.figures.trials import describe_incompleteness

    if len(logs) == 1:
        return describe_incompleteness(logs[0])
    incomplete = sum(1 for log in logs if describe_incompleteness(log))
    if not incomplete:
        return ""
    exclusion = "" if incomplete == len(logs) else ", not in the means"
    return f"{incomplete} of {len(logs)} trials did not run to their end{exclusion}"

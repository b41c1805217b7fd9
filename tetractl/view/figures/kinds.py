"""The figures of `tetractl plot` by name. A new figure is one file and one line here."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from tetractl.core.errors import UsageError
from tetractl.core.registry import Registry

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tetractl.log.read.trial_log import TrialLog

FIGURES = Registry(
    "tetractl.figures",
    "figure",
    {
        "trajectory": "tetractl.view.figures.trajectory:trajectory_figure",
        "convergence": "tetractl.view.figures.convergence:convergence_figure",
        "error": "tetractl.view.figures.curves:error_figure",
        "errors": "tetractl.view.figures.curves:errors_figure",
        "arms": "tetractl.view.figures.curves:arms_figure",
        "ecdf": "tetractl.view.figures.ecdf:ecdf_figure",
        "scatter": "tetractl.view.figures.scatter:scatter_figure",
        "swarm": "tetractl.view.figures.swarm:swarm_figure",
        "estimate": "tetractl.view.figures.estimate:estimate_figure",
        "timing": "tetractl.view.figures.timing:timing_figure",
    },
)


def check_kind(kind: str) -> None:
    """Raise UsageError for a name that no figure has."""
    if kind not in FIGURES:
        raise UsageError(
            f"no figure is called {kind!r}",
            f"there are {', '.join(FIGURES.names())}, and video for a film",
        )


def draw(kind: str, logs: "Sequence[TrialLog]") -> "Figure":
    """Draw the figure of a kind, headed by what was steered and by what broke a trial off.

    Only `trajectory`, `errors`, `arms`, `ecdf` and `scatter` show several trials.
    """
    from tetractl.view.figures.axes import broken_off
    from tetractl.view.style import headline

    check_kind(kind)
    figure = FIGURES.load(kind)(logs)
    headline(figure, ", ".join(sorted({log.origin.value for log in logs})), broken_off(logs))
    return figure

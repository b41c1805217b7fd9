"""Functions of the Python interface that draw trials: figures, videos, players, and games."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, overload

from tetractl.api.logs import Trial, as_trials
from tetractl.api.simulated_trials import run_trial
from tetractl.api.specs import Spec, as_spec
from tetractl.core.errors import UsageError
from tetractl.log.read.trial_log import TrialLog

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tetractl.report.html_page import FramedPage
    from tetractl.statistics.describe import BatchComparison, BatchStatistics
    from tetractl.statistics.open_batch import Batch
    from tetractl.view.video import Video


@overload
def plot(  # pyright: ignore[reportOverlappingOverload] - every other text is a figure's
    data: "Trial", kind: Literal["video"], *, file: str | Path | None = None
) -> "Video": ...


@overload
def plot(
    data: "Trial | Sequence[Trial] | Batch | BatchStatistics | BatchComparison",
    kind: str = "trajectory",
    *,
    file: str | Path | None = None,
) -> "Figure": ...


def plot(
    data: "Trial | Sequence[Trial] | Batch | BatchStatistics | BatchComparison",
    kind: str = "trajectory",
    *,
    file: str | Path | None = None,
) -> "Figure | Video":
    """Draw a figure of trials or statistics with matplotlib, and optionally save it.

    Args:
        data: What to draw: a trial, several trials, a batch, statistics or a comparison. Logs and
            folders are read.
        kind: A figure of `tetractl plot`, such as "trajectory", or "video" for a video of one
            trial. The kinds "trajectory", "errors" and "batch" can show several trials. Statistics
            and comparisons are always drawn as "batch".
        file: Where to save the figure (.png, .svg, .pdf) or the video (.mp4, .gif, .webp). By
            default, it is not saved.

    Returns:
        The matplotlib figure, or the video.

    Raises:
        UsageError: If the kind is unknown, or cannot show this many trials.

    Example:
        >>> figure = tetractl.plot("logs/cell/trial-000.mcap", file="trial.png")
    """
    from tetractl.statistics.describe import BatchComparison, BatchStatistics
    from tetractl.view import style
    from tetractl.view.figures.batch import batch_figure
    from tetractl.view.figures.draw import draw

    if isinstance(data, BatchComparison):
        figure = batch_figure(data.groups)
    elif isinstance(data, BatchStatistics):
        figure = batch_figure([data])
    elif kind == "video":
        return _video(as_trials(data), file)
    else:
        figure = draw(kind, as_trials(data))
    if file is not None:
        style.save(figure, Path(file))
    return figure


def _video(trials: Sequence[TrialLog], file: str | Path | None) -> "Video":
    from tetractl.view.video import video

    if len(trials) > 1:
        raise UsageError(f"a video shows one trial, not {len(trials)}")
    return video(trials[0], None if file is None else Path(file))


def show(data: "Trial | Sequence[Trial] | Batch") -> "FramedPage":
    """Return the report's interactive player for one or more trials, for a notebook to display.

    Args:
        data: A trial or its log, several trials, a batch, or the folder of a batch.

    Example:
        >>> player = tetractl.show("logs/cell/trial-000.mcap")
    """
    from tetractl.report.page import player

    return player(as_trials(data))


def play_page(spec: Spec, *, file: str | Path | None = None) -> "FramedPage":
    """Make a web page on which anybody can steer the robots of a spec by hand.

    The page needs no server and no network. Its robots follow the spec's model, without
    disturbances. The page also contains one trial of the spec's controller, which this function
    simulates.

    Args:
        spec: The experiment: a loaded spec, a YAML file, or its contents.
        file: Where to write the page (.html). By default, it is not written.

    Returns:
        The page, which a notebook shows. Its HTML is the attribute `page`.

    Raises:
        SpecError: If the spec has a hold or way-points, which cannot be played.
        UsageError: If a camera must first find the robots, or if they follow a motion that the page
            does not know.

    Example:
        >>> page = tetractl.play_page("experiments/single_cell.yaml", file="play.html")
    """
    from tetractl.report import play_page as page
    from tetractl.run.open_trial import directed_spec
    from tetractl.run.undisturbed import undisturbed_spec
    from tetractl.tools.files import write_atomically

    if file is not None and not Path(file).absolute().parent.is_dir():
        raise UsageError(f"{file}: the folder {Path(file).parent} does not exist")
    undisturbed = undisturbed_spec(as_spec(spec))
    directed_spec(undisturbed)  # refuses what cannot be steered by hand
    page.refuse_unknown_motion(undisturbed)
    made = page.play_page(undisturbed, run_trial(undisturbed))
    if file is not None:
        write_atomically(Path(file), made.page.encode())
    return made

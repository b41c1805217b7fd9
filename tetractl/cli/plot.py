"""The command `tetractl plot`, which draws a figure or a video of recorded trials."""

from os.path import commonpath
from pathlib import Path
from typing import Annotated

from tetractl.cli import ui
from tetractl.cli.options import Logs, option, out_option
from tetractl.core.errors import Exit, UsageError, printable
from tetractl.log.read.find import find_logs

TRAJECTORY = "trajectory"
"""The figure that is drawn by default."""
VIDEO = "video"


def plot(
    logs: Logs,
    out: Annotated[
        Path | None,
        out_option(
            "FILE",
            "Image to write (.png, .svg or .pdf), by default LOG-KIND.png in the current "
            "folder. For a video: .mp4, .gif or .webp, by default LOG-video.gif.",
        ),
    ] = None,
    kind: Annotated[
        str | None, option("NAME", "Figure to draw, one of the names listed above. [trajectory]")
    ] = None,
) -> int:
    """Draw a figure of one trial or several, and print the name of its file.

    trajectory: the robots' paths in one trial or several, as in the paper's Figure 5.
    convergence: the cost over the iterations of a search, as in the paper's Figure 3.
    swarm: the particles of the first search, as in the paper's Figure 2 (from tetractl-papers).
    errors: the errors over time of one trial, or of several trials with their median by folder.
    batch: the final errors by folder: each trial, the mean with its interval, the distribution.
    over-time: the signal, the solve times, and the estimates of turning rate a, speed and so on.
    video: the trial as a video. MP4 needs ffmpeg.

    Installed packages may add figures. The same log always gives the same bytes.

    Example: tetractl plot trial-000.mcap --kind convergence -o convergence.pdf
    """
    from tetractl.view.figures.draw import check_kind, draw
    from tetractl.view.style import file_format, save

    if kind == VIDEO:
        return _video(find_logs(logs), out)
    figure = kind or TRAJECTORY
    check_kind(figure)  # before the logs are read
    log_paths = find_logs(logs)
    path = out or _default_name(log_paths, figure)
    file_format(path)
    trials = [ui.open_trial(log) for log in log_paths]
    save(draw(figure, trials), path)
    print(printable(str(path)))
    return Exit.FAILED if any(trial.damage for trial in trials) else Exit.DONE


def _video(logs: list[Path], out: Path | None) -> int:
    """Write the video of one trial, print the name of its file, and return the exit code."""
    from tetractl.view.video import check_video_file, write_video

    if len(logs) > 1:
        raise UsageError(f"a video shows a single trial, but {len(logs)} are given", "give one log")
    path = out or _default_name(logs, VIDEO).with_suffix(".gif")
    check_video_file(path)
    log = ui.open_trial(logs[0])
    with ui.show_progress("Drawing") as on_picture:
        speed = write_video(log, path, on_picture)
    if speed > 1:
        ui.print_messages(f"the video plays {speed} times faster than the trial")
    print(printable(str(path)))
    return Exit.FAILED if log.damage else Exit.DONE


def _default_name(logs: list[Path], kind: str) -> Path:
    """Return the name of the image file: that of the log, or of the folder with all the logs."""
    common = Path(commonpath([log.absolute().parent for log in logs]))
    name = logs[0].name if len(logs) == 1 else common.name or "trials"
    return Path(f"{name.partition('.mcap')[0]}-{kind}.png")

"""`tetractl plot`: draws figures of logs, such as those of the paper."""

import sys
from os.path import commonpath
from pathlib import Path
from typing import Annotated

import typer

from tetractl.cli.options import Logs, open_trial, progress
from tetractl.core.errors import Exit, UsageError

VIDEO = "video"


def plot(
    logs: Logs,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="FILE",
            help="Picture to write: .png, .svg or .pdf; by default LOG-KIND.png in this folder. "
            "A film: .mp4, .gif or .webp, by default LOG-video.gif.",
        ),
    ] = None,
    kind: Annotated[
        str, typer.Option(metavar="NAME", help="The figure to draw, a name from the list above.")
    ] = "trajectory",
) -> int:
    """Draw a figure of a trial and print the name of its file.

    trajectory: paths in one trial or several, the paper's Figure 5.
    convergence: cost over the iterations, the paper's Figure 3.
    swarm: particles of the first search, the paper's Figure 2.
    error: distances to the targets over time.
    errors: errors of several trials over time, with their median, by folder.
    arms: the median error of each of several folders over time.
    ecdf: fraction of each folder's trials that ended with an error up to a value.
    scatter: where the robots of several trials ended, by folder.
    estimate: the controller's estimates of turning rate a, speed and so on over time.
    timing: solve time of each control step.
    video: a film of the trial.
    Installed packages may add figures.

    The same log gives the same bytes. MP4 films need ffmpeg.

    Example: tetractl plot trial-000.mcap --kind convergence -o convergence.pdf
    """
    from tetractl.core.errors import printable
    from tetractl.log.read.find import find_logs
    from tetractl.view.figures.draw import check_kind, draw
    from tetractl.view.style import file_format, save

    if kind == VIDEO:
        return _film(find_logs(logs), output)
    check_kind(kind)
    logs = find_logs(logs)
    path = output or _default_name(logs, kind)
    file_format(path)
    trials = [open_trial(log) for log in logs]
    save(draw(kind, trials), path)
    print(printable(str(path)))
    return Exit.FAILED if any(trial.damage for trial in trials) else Exit.DONE


def _film(logs: list[Path], output: Path | None) -> int:
    from tetractl.view.film import check_file, write_video

    if len(logs) > 1:
        raise UsageError(f"a film shows one trial, not {len(logs)}", "give one log")
    path = output or _default_name(logs, VIDEO).with_suffix(".gif")
    check_file(path)
    log = open_trial(logs[0])
    with progress("Drawing") as on_picture:
        speed = write_video(log, path, on_picture)
    if speed > 1:
        print(f"plays {speed} times faster than the trial", file=sys.stderr)
    print(path)
    return Exit.FAILED if log.damage else Exit.DONE


def _default_name(logs: list[Path], kind: str) -> Path:
    common = Path(commonpath([log.absolute().parent for log in logs]))
    name = logs[0].name if len(logs) == 1 else common.name or "trials"
    return Path(f"{name.partition('.mcap')[0]}-{kind}.png")

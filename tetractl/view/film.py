"""Films of a trial: the arena with the robots, the error over time, and numbers. The static part is
drawn once; each picture adds the moving parts. ffmpeg, if installed, writes MP4; Pillow writes GIF
and animated WebP.
"""

import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.text import Text
from numpy.typing import NDArray
from PIL import Image

from tetractl.core.clock import SECOND
from tetractl.core.colors import robot_colors
from tetractl.core.errors import LogError, UsageError, unit_of
from tetractl.core.poses import Floats
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.player import Moment, Recording, tracked
from tetractl.view import style
from tetractl.view.figures.axes import NUMBERED, need_steps, robot_labels, unfinished
from tetractl.view.figures.trajectory import DishGround, draw_scene

FORMATS = {"mp4": 25, "gif": 20, "webp": 25}
"""Pictures per second by format; a GIF can only state intervals in hundredths of a second."""
WIDTH = 960
HOLD_S = 1.5
"""Time for which the last picture is shown [s]."""
LONGEST_S = 60.0
SPEEDS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
ARENA_IN = (5.0, 4.4)  # largest width and height of the arena
SIDE_IN = 2.2  # width of the curve and the numbers
MARGINS_IN = (0.62, 0.45, 0.62, 0.3)  # left of and below the arena, between arena and side, above
TRAIL_POINTS = 600
BODY = 0.028
"""Least length of a robot's wedge, relative to the arena's longer side."""

Picture = NDArray[np.uint8]


def check_file(path: Path) -> str:
    """Return the format of a film, which the ending of its name states.

    Raises UsageError for another ending, for a missing folder, and for MP4 without ffmpeg.
    """
    ending = style.file_format(path, FORMATS, "film")
    if ending == "mp4" and shutil.which("ffmpeg") is None:
        raise UsageError(
            f"{path}: an MP4 needs ffmpeg, which is not installed",
            "install ffmpeg, or end the name in .gif or .webp",
        )
    return ending


def write_video(
    log: TrialLog,
    path: Path,
    progress: Callable[[int, int], None] = lambda done, total: None,
    width: int = WIDTH,
) -> int:
    """Write a film of a trial and return how many times faster than the trial it plays.

    A trial of more than a minute plays faster, by a factor of 2, 5, 10 and so on. `progress` is
    called with the numbers of pictures drawn and of all pictures. Raises LogError if the file
    cannot be written.
    """
    ending = check_file(path)
    rate = FORMATS[ending]
    frames = FilmFrames(log, width)
    recording = frames.recording
    end_s = max(recording.elapsed_s(recording.end_ns), 0.0)
    speed = next((s for s in SPEEDS if end_s / s <= LONGEST_S), SPEEDS[-1])
    times = np.append(np.arange(0, end_s, speed / rate), end_s).tolist()
    hold = round(HOLD_S * rate)

    def pictures() -> Iterator[Picture]:
        for done, time_s in enumerate(times, 1):
            yield frames.at(time_s)
            progress(done, len(times))

    try:
        if ending == "mp4":
            _mp4(path, pictures(), rate, hold)
        else:
            _animation(path, pictures(), len(times), rate, hold)
    except OSError as error:
        path.unlink(missing_ok=True)
        raise LogError(f"{path}: cannot write the film: {error}") from error
    return speed


def _animation(path: Path, pictures: Iterator[Picture], count: int, rate: int, hold: int) -> None:
    """Write a GIF or a WebP; the last picture is shown `hold` times as long."""
    milliseconds = round(1000 / rate)
    durations = [milliseconds] * (count - 1) + [milliseconds * (1 + hold)]
    images = map(Image.fromarray, pictures)
    first = next(images)
    options: dict[str, Any] = {"quality": 80, "method": 1, "kmin": 25, "kmax": 50}
    if path.suffix.lower() == ".gif":
        palette = first.quantize(256, dither=Image.Dither.NONE)
        first = first.quantize(palette=palette, dither=Image.Dither.NONE)
        images = (one.quantize(palette=palette, dither=Image.Dither.NONE) for one in images)
        options = {"optimize": False, "disposal": 1}
    first.save(path, save_all=True, append_images=images, duration=durations, loop=0, **options)


def _mp4(path: Path, pictures: Iterator[Picture], rate: int, hold: int) -> None:
    """Write an MP4; the last picture is repeated `hold` times."""
    last = next(pictures)
    command = [
        "ffmpeg", "-y", "-loglevel", "error",
        "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{last.shape[1]}x{last.shape[0]}",
        "-r", str(rate), "-i", "-",
        "-c:v", "libx264", "-preset", "veryfast", "-crf", "20", "-pix_fmt", "yuv420p",
        "-movflags", "+faststart", "-fflags", "+bitexact", "-f", "mp4", str(path),
    ]  # fmt: skip
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdin is not None and process.stderr is not None
        try:
            process.stdin.write(last.tobytes())
            for last in pictures:
                process.stdin.write(last.tobytes())
            for _ in range(hold):
                process.stdin.write(last.tobytes())
            process.stdin.close()
        except BrokenPipeError:
            pass  # ffmpeg ended; stderr has the reason
        said = process.stderr.read().decode(errors="replace").strip()
        if process.wait() != 0:
            raise OSError(said.splitlines()[-1] if said else "ffmpeg failed")


class FilmFrames:
    """Draws the pictures of a film of a trial: arrays (height, width, 3) with even height and
    width.

    Raises LogError for a log without control steps.
    """

    def __init__(self, log: TrialLog, width: int) -> None:
        need_steps(log)
        self.recording = Recording(log)
        setup = self._setup = log.start.setup
        self._colors = robot_colors(setup.names, setup.colors)
        heading = f"{setup.name}, trial {log.start.trial}: {log.origin.value}"
        if text := unfinished(log):
            heading += f" ({text})"
        arena = setup.arena
        scale = min(ARENA_IN[0] / arena.width, ARENA_IN[1] / arena.height)
        wide, high = scale * arena.width, scale * arena.height
        left, below, between, above = MARGINS_IN
        size = left + wide + between + SIDE_IN + 0.12, below + max(high, 3.0) + above
        dpi = 2 * round(width / 2) / size[0]
        size = size[0], 2 * round(size[1] * dpi / 2) / dpi
        lower = (size[1] - above - high) / size[1]
        with style.styled():
            figure = Figure(figsize=size, dpi=dpi)
            self._canvas = FigureCanvasAgg(figure)
            figure.text(0.01, 0.985, heading[:120], va="top", color=style.GREY, fontsize=7.5)
            scene = figure.add_axes((left / size[0], lower, wide / size[0], high / size[1]))
            side = (left + wide + between) / size[0], SIDE_IN / size[0], 1 - above / size[1]
            self._ground = DishGround(scene, log)
            self._moving = [*self._arena(scene, log), *self._course(figure, side, log)]
            for artist in self._moving:
                artist.set_animated(True)
            self._canvas.draw()
            self._still = self._canvas.copy_from_bbox(figure.bbox)

    def _arena(self, axes: Axes, log: TrialLog) -> list[Line2D | Polygon]:
        """Draw the arena, and return the parts that move: plans, trails and robots."""
        arena = self._setup.arena
        draw_scene(axes, self._setup, self._colors, [tracked(log.mocap, log.valid)])
        axes.set_xlim(arena.left, arena.right)
        axes.set_ylim(arena.bottom, arena.top)
        self._body = max(self._setup.wheel_radius or 0.0, BODY / 2 * max(arena.width, arena.height))
        self._plans, self._trails, self._robots = list[Line2D](), list[Line2D](), list[Polygon]()
        for color in self._colors:
            self._plans += axes.plot([], [], ".", color=color, ms=2.5, mew=0, zorder=3)
            self._trails += axes.plot([], [], color=color, lw=1.3, zorder=4)
            wedge = Polygon(np.zeros((4, 2)), facecolor=color, edgecolor="white", linewidth=0.6)
            wedge.set_zorder(6)
            axes.add_patch(wedge)
            self._robots.append(wedge)
        return [*self._plans, *self._trails, *self._robots]

    def _course(
        self, figure: Figure, side: tuple[float, float, float], log: TrialLog
    ) -> list[Line2D | Text]:
        """Draw the axes of the total error and, below them, those of the direction u; return the
        parts that change: the curve, the arrow of u, and the numbers.

        `side` is the left end, the width and the upper end of this part, as fractions of the
        figure.
        """
        setup, recording = self._setup, self.recording
        left, width, top = side
        axes = figure.add_axes((left, 0.56, width, top - 0.56))
        self._times = np.array([log.elapsed_s(int(t)) for t in recording.step_ns])
        self._totals = recording.totals
        axes.plot(self._times, self._totals, color=style.FAINT, lw=1.2)
        axes.set_xlim(0, max(recording.elapsed_s(recording.end_ns), 1e-9))
        axes.set_ylim(0, 1.05 * float(np.nanmax(self._totals, initial=1e-9)))
        axes.set_ylabel(f"total error [{unit_of(setup.unit)}]")
        axes.set_xlabel("time [s]")
        (self._curve,) = axes.plot([], [], color=style.INK, lw=1.5)
        self._names = robot_labels(setup.names) if len(setup.names) < NUMBERED else []
        inks = [*[style.INK] * 3, *self._colors[: len(self._names)]]
        rows = 0.42 - 0.4 * np.arange(len(inks)) / max(len(inks), 7)
        self._texts = [
            figure.text(left - 0.05, float(row), "", color=ink, fontsize=8.5)
            for row, ink in zip(rows, inks, strict=True)
        ]
        dial = figure.add_axes((left + 0.8 * width, 0.36, 0.2 * width, 0.1))
        dial.set(xlim=(-1.2, 1.2), ylim=(-1.2, 1.2), aspect="equal")
        dial.set_axis_off()
        dial.text(-1.6, 0, "$u$", ha="right", va="center")
        (self._arrow,) = dial.plot([], [], color=style.INK, lw=1.4, clip_on=False)
        return [self._curve, self._arrow, *self._texts]

    def at(self, elapsed_s: float) -> Picture:
        """Return the picture at `elapsed_s` [s] after the first direction sent."""
        when = self.recording.began_ns + round(elapsed_s * SECOND)
        self._show(self.recording.at(when))
        if self._ground.show(when):
            self._canvas.draw()
            self._still = self._canvas.copy_from_bbox(self._canvas.figure.bbox)
        self._canvas.restore_region(self._still)
        renderer = self._canvas.get_renderer()
        for artist in self._moving:
            artist.draw(renderer)
        return np.asarray(self._canvas.buffer_rgba())[..., :3]

    def _show(self, moment: Moment) -> None:
        trail, step = moment.trail, moment.step
        thin = trail[:: max(1, len(trail) // TRAIL_POINTS)]
        running = step is not None and not moment.result
        plan = step.plan.path if step is not None and running else None
        for robot, (x, y, heading) in enumerate(moment.poses):
            self._trails[robot].set_data(*np.vstack([thin[:, robot], [x, y]]).T)
            self._robots[robot].set_xy(_wedge(x, y, heading, self._body))
            self._plans[robot].set_data(*(plan[:, robot, :2].T if plan is not None else ([], [])))
        u = step.plan.direction if step is not None and running else None
        points = np.zeros(0) if u is None else ARROW * np.exp(1j * u)
        self._arrow.set_data(points.real, points.imag)
        done = len(moment.totals)
        total = float(np.nansum(moment.distances))
        self._curve.set_data(
            np.append(self._times[:done], moment.time_s), np.append(self._totals[:done], total)
        )
        unit = unit_of(self._setup.unit)
        words = [
            f"{moment.time_s:.1f} s" + (f", step {step.k}" if step else ""),
            f"{len(step.plan.signals)} signals planned, J {step.plan.cost:.3g} {unit}"
            if step
            else "",
            f"total error {total:.1f} {unit}",
            *(f"{n} {e:.1f} {unit}" for n, e in zip(self._names, moment.distances, strict=False)),
        ]
        for text, line in zip(self._texts, words, strict=True):
            text.set_text(line)


ARROW = np.array([-1, 1, 0.6 + 0.3j, 1, 0.6 - 0.3j])
"""The line of an arrow along +x: its points x + iy."""


def _wedge(x: float, y: float, heading: float, half: float) -> Floats:
    """Return the corners (4, 2) of a robot's wedge, the front corner first; `half` is half its
    length.
    """
    corners = np.array([1.2, -1 + 0.8j, -0.6, -1 - 0.8j]) * half * np.exp(1j * heading)
    return np.column_stack([x + corners.real, y + corners.imag])

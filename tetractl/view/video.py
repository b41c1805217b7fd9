"""Videos of a trial: the arena with the robots, the error over time, and numbers. The static part
is drawn once; each picture adds the moving parts. ffmpeg, if installed, writes MP4; Pillow writes
GIF and animated WebP.
"""

import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import count
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

from tetractl.core.children import Child
from tetractl.core.clock import SECOND
from tetractl.core.colors import robot_colors
from tetractl.core.errors import LogError, UsageError, unit_of
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.player import Moment, Recording, tracked
from tetractl.view import style
from tetractl.view.figures.axes import NUMBERED, need_steps, robot_labels, unfinished
from tetractl.view.figures.trajectory import DishGround, draw_scene

FORMATS = {"mp4": 25, "gif": 20, "webp": 25}
"""Pictures per second by format; a GIF can only state intervals in hundredths of a second."""
HOLD_S = 1.5
"""Time for which the last picture is shown [s]."""
LONGEST_S = 60.0
ARROW = np.array([-1, 1, 0.6 + 0.3j, 1, 0.6 - 0.3j])
"""The line of an arrow along +x: its points x + iy."""
WEDGE = np.array([1.2, -1 + 0.8j, -0.6, -1 - 0.8j])
"""The corners of a robot that heads along +x, the front corner first, for half a length of 1."""

Picture = NDArray[np.uint8]


def check_file(path: Path) -> str:
    """Return the format of a video, which the ending of its name states.

    Raises UsageError for another ending, for a missing folder, and for MP4 without ffmpeg.
    """
    ending = style.file_format(path, FORMATS, "video")
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
    width: int = 960,
) -> int:
    """Write a video of a trial and return how many times faster than the trial it plays.

    A trial of more than a minute plays faster, by a factor of 2, 5, 10 and so on. `progress` is
    called with the numbers of pictures drawn and of all pictures. Raises LogError if the file
    cannot be written.
    """
    ending = check_file(path)
    rate = FORMATS[ending]
    frames = VideoFrames(log, width)
    recording = frames.recording
    end_s = max(recording.elapsed_s(recording.end_ns), 0.0)
    steps = (m * 10**power for power in count() for m in (1, 2, 5))
    speed = next(s for s in steps if end_s / s <= LONGEST_S)
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
        raise LogError(f"{path}: cannot write the video: {error}") from error
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
    with Child(command, fed=True) as encoder:
        with suppress(BrokenPipeError):  # ffmpeg ended; what it said has the reason
            encoder.stdin.write(last.tobytes())
            for last in pictures:
                encoder.stdin.write(last.tobytes())
            encoder.stdin.write(last.tobytes() * hold)
            encoder.stdin.close()
        if encoder.wait() != 0:
            raise OSError((encoder.said() or ["ffmpeg failed"])[-1])


class VideoFrames:
    """Draws the pictures of a video of a trial: arrays (height, width, 3) with even height and
    width.

    Raises LogError for a log without control steps.
    """

    @style.styled()
    def __init__(self, log: TrialLog, width: int) -> None:
        need_steps(log)
        self.recording = Recording(log)
        setup = self._setup = log.start.setup
        heading = f"{setup.name}, trial {log.start.trial}: {log.origin.value}"
        if text := unfinished(log):
            heading += f" ({text})"
        arena = setup.arena
        # inches: at most 5 x 4.4 of the arena, its labels, and to its right 2.2 of numbers
        scale = min(5.0 / arena.width, 4.4 / arena.height)
        wide, high, side = scale * arena.width, scale * arena.height, 2.2
        size = wide + side + 1.36, max(high, 3.0) + 0.75
        dpi = 2 * round(width / 2) / size[0]
        size = size[0], 2 * round(size[1] * dpi / 2) / dpi
        figure = Figure(size, dpi)
        self._canvas = FigureCanvasAgg(figure)

        def axes(left: float, low: float, width: float, height: float) -> Axes:
            inches = left / size[0], low / size[1], width / size[0], height / size[1]
            return figure.add_axes(inches)

        figure.text(0.01, 0.985, heading[:120], va="top", color=style.GREY, fontsize=7.5)
        scene = axes(0.62, size[1] - 0.3 - high, wide, high)
        self._ground = DishGround(scene, log)
        self._robots = self._draw_robots(scene, log)
        middle = 0.56 * size[1]
        self._curve = self._draw_curve(axes(wide + 1.24, middle, side, size[1] - 0.3 - middle))
        words = axes(wide + 1.24, 0.1, side, middle - 0.7)
        self._arrow, self._texts = self._draw_words(words)
        robots = [artist for robot in self._robots for artist in robot]
        self._moving = [*robots, self._curve, self._arrow, *self._texts]
        for artist in self._moving:
            artist.set_animated(True)
        self._draw_still()

    def _draw_still(self) -> None:
        self._canvas.draw()
        self._still = self._canvas.copy_from_bbox(self._canvas.figure.bbox)

    def _draw_robots(self, axes: Axes, log: TrialLog) -> list[tuple[Line2D, Line2D, Polygon]]:
        """Draw the arena, and return each robot's plan, trail and body, in order of depth."""
        setup = self._setup
        self._colors = robot_colors(setup.names, setup.colors)
        draw_scene(axes, [setup], self._colors, [tracked(log.mocap, log.valid)])
        arena = setup.arena
        axes.set(xlim=(arena.left, arena.right), ylim=(arena.bottom, arena.top))
        least = 0.014 * max(arena.width, arena.height)  # to be seen
        self._body = max(setup.wheel_radius or 0.0, least)
        robots = []
        for color in self._colors:
            (plan,) = axes.plot([], [], ".", color=color, ms=2.5, mew=0)
            (trail,) = axes.plot([], [], color=color, lw=1.3)
            body = Polygon(np.zeros((4, 2)), fc=color, ec="white", lw=0.6)
            axes.add_patch(body)
            robots.append((plan, trail, body))
        return robots

    def _draw_curve(self, axes: Axes) -> Line2D:
        """Draw the axes and the course of the total error; return the curve up to a time."""
        recording = self.recording
        self._times = (recording.step_ns - recording.began_ns) / SECOND
        axes.plot(self._times, recording.totals, color=style.FAINT, lw=1.2)
        axes.set_xlim(0, max(recording.elapsed_s(recording.end_ns), 1e-9))
        axes.set_ylim(0, 1.05 * float(np.nanmax(recording.totals, initial=1e-9)))
        axes.set(xlabel="time [s]", ylabel=f"total error [{unit_of(self._setup.unit)}]")
        return axes.plot([], [], color=style.WHOLE, lw=1.5)[0]

    def _draw_words(self, axes: Axes) -> tuple[Line2D, list[Text]]:
        """Return the arrow of the direction u, and a line of text for each number."""
        names = self._setup.names
        self._names = robot_labels(names) if len(names) < NUMBERED else []
        axes.set_axis_off()
        inks = [*[style.INK] * 3, *self._colors[: len(self._names)]]
        heights = 0.92 - np.arange(len(inks)) / max(len(inks), 7)
        texts = [
            axes.text(
                -0.2,
                float(y),
                "",
                color=ink,
                fontsize=8.5,
                transform=axes.transAxes,
                in_layout=False,
            )
            for y, ink in zip(heights, inks, strict=True)
        ]
        dial = axes.inset_axes((0.8, 0.85, 0.2, 0.22))
        dial.set(xlim=(-1.2, 1.2), ylim=(-1.2, 1.2), aspect="equal")
        dial.set_axis_off()
        dial.text(-1.6, 0, "$u$", ha="right", va="center")
        return dial.plot([], [], color=style.WHOLE, lw=1.4, clip_on=False)[0], texts

    def at(self, elapsed_s: float) -> Picture:
        """Return the picture at `elapsed_s` [s] after the first direction sent."""
        when = self.recording.began_ns + round(elapsed_s * SECOND)
        self._show(self.recording.at(when))
        if self._ground.show(when):
            self._draw_still()
        self._canvas.restore_region(self._still)
        renderer = self._canvas.get_renderer()
        for artist in self._moving:
            artist.draw(renderer)
        return np.asarray(self._canvas.buffer_rgba())[..., :3]

    def _show(self, moment: Moment) -> None:
        trail, step = moment.trail, moment.step
        thin = trail[:: max(1, len(trail) // 600)]
        next_plan = None if step is None or moment.result else step.plan
        for i, (plan, path, body) in enumerate(self._robots):
            x, y, heading = moment.poses[i]
            plan.set_data(*(next_plan.path[:, i, :2].T if next_plan else ([], [])))
            path.set_data(*np.vstack([thin[:, i], [x, y]]).T)
            corners = self._body * WEDGE * np.exp(1j * heading)
            body.set_xy(np.column_stack([x + corners.real, y + corners.imag]))
        u = next_plan.direction if next_plan else None
        arrow = np.zeros(0) if u is None else ARROW * np.exp(1j * u)
        self._arrow.set_data(arrow.real, arrow.imag)
        done, unit = len(moment.totals), unit_of(self._setup.unit)
        total = float(np.nansum(moment.distances))
        self._curve.set_data(
            np.append(self._times[:done], moment.time_s), np.append(moment.totals, total)
        )
        words = [f"{moment.time_s:.1f} s", "", f"total error {total:.1f} {unit}, {moment.known}"]
        if step:
            words[0] += f", step {step.k}"
        if step and not step.plan.pauses:
            words[1] = f"{len(step.plan.signals)} signals planned, J {step.plan.cost:.3g} {unit}"
        words += [
            f"{n} {e:.1f} {unit}" for n, e in zip(self._names, moment.distances, strict=False)
        ]
        for text, line in zip(self._texts, words, strict=True):
            text.set_text(line)

"""Videos of a recorded trial: the arena with the robots, the error over time, and numbers.

What does not move is drawn once. Each image of the video adds the moving parts. ffmpeg, if
installed, writes MP4. Pillow writes GIF and animated WebP.
"""

import shutil
from base64 import b64encode
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from numpy.typing import NDArray
from PIL import Image

from tetractl.core.clock import SECOND
from tetractl.core.colors import robot_colors
from tetractl.core.errors import LogError, UsageError, format_unit
from tetractl.core.setup import Bounds
from tetractl.core.trial import Step
from tetractl.log.read.trial_log import TrialLog
from tetractl.tools.children import Child
from tetractl.view import style
from tetractl.view.figures.trajectory import DishBackground, draw_scene
from tetractl.view.figures.trials import (
    NUMBERED_MIN,
    describe_incompleteness,
    require_steps,
    robot_labels,
)
from tetractl.view.player import Moment, Recording

FORMATS = {"mp4": 25, "gif": 20, "webp": 25}
"""Images per second by format; a GIF can only state intervals in hundredths of a second."""
LAST_IMAGE_S = 1.5
"""Time for which the last image is shown [s]."""
DURATION_MAX_S = 60.0
"""Maximum duration of a video [s]. A longer trial plays faster."""
SCENE_WIDTH_IN = 5.0
"""Maximum width of the arena in the video [in]."""
SCENE_HEIGHT_IN = 4.4
"""Maximum height of the arena in the video [in]."""
SIDE_WIDTH_IN = 2.2
"""Width of the curve and the words, to the right of the arena [in]."""
SIDE_HEIGHT_IN = 3.0
"""Minimum height of the curve and the words together [in]."""
LABELS_IN = 0.62
"""Space for the labels of an axis, on its left [in]."""
TOP_IN = 0.3
"""Space for the heading [in]."""
HEADING_LENGTH_MAX = 120
"""Maximum length of the heading [characters]."""
NOTEBOOK_WIDTH_PX = 640
"""Width of a video inside a notebook [px]."""
NOTEBOOK_RATE_HZ = 12
"""Images per second of a video inside a notebook. They are few, so that it is ready in seconds."""
BODY_FRACTION_MIN = 0.014
"""Minimum half length of a drawn robot as a fraction of the arena, so that it is visible."""
TRAIL_POINTS = 600
"""Approximate number of points of a trail that are drawn."""
ARROW_POINTS = np.array([-1, 1, 0.6 + 0.3j, 1, 0.6 - 0.3j])
"""The line of an arrow along +x: its points x + iy."""
ROBOT_CORNERS = np.array([1.2, -1 + 0.8j, -0.6, -1 - 0.8j])
"""The corners of a robot that heads along +x, the front corner first, for half a length of 1."""

Picture = NDArray[np.uint8]


def check_video_file(path: Path) -> str:
    """Determine the format of a video to write from the ending of the file's name.

    Raises:
        UsageError: If there is no format with this ending, if the folder does not exist, or if
            ffmpeg is not installed and the format is MP4.
    """
    ending = style.file_format(path, FORMATS, "video")
    if ending == "mp4" and shutil.which("ffmpeg") is None:
        raise UsageError(
            f"{path}: writing an MP4 needs ffmpeg, which is not installed",
            "install ffmpeg, or write a .gif or .webp instead",
        )
    return ending


def write_video(
    log: TrialLog,
    path: Path,
    progress: Callable[[int, int], None] = lambda drawn, total: None,
    width: int = 960,
    rate: int | None = None,
) -> int:
    """Write a video of a trial.

    A trial of more than a minute plays faster, by a factor of 2, 5, 10 and so on.

    Args:
        log: The trial.
        path: The file.
        progress: Called with the number of images drawn and of all images.
        width: Width of the video [px].
        rate: Number of images per second. None for the default of the format.

    Returns:
        How many times faster than the trial the video plays.

    Raises:
        LogError: If the file cannot be written.
    """
    ending = check_video_file(path)
    rate = rate or FORMATS[ending]
    frames = VideoFrames(log, width)
    recording = frames.recording
    end_s = max(recording.log.elapsed_s(recording.end_ns), 0.0)
    speed = _choose_speed(end_s)
    times_s = np.append(np.arange(0, end_s, speed / rate), end_s).tolist()
    hold_images = round(LAST_IMAGE_S * rate)

    def pictures() -> Iterator[Picture]:
        for drawn, time_s in enumerate(times_s, 1):
            yield frames.draw_at(time_s)
            progress(drawn, len(times_s))

    try:
        if ending == "mp4":
            _write_mp4(path, pictures(), rate, hold_images)
        else:
            _write_animation(path, pictures(), len(times_s), rate, hold_images)
    except OSError as error:
        path.unlink(missing_ok=True)
        raise LogError(f"{path}: the video cannot be written: {error}") from error
    return speed


@dataclass(frozen=True, slots=True)
class Video:
    """A video of a trial, as the bytes of a file in the format `format`. A notebook plays it."""

    format: str
    data: bytes = field(repr=False)

    def _repr_html_(self) -> str:
        encoded = b64encode(self.data).decode()
        if self.format == "mp4":
            source = f"data:video/mp4;base64,{encoded}"
            return f'<video controls loop width="{NOTEBOOK_WIDTH_PX}" src="{source}">'
        source = f"data:image/{self.format};base64,{encoded}"
        return f'<img alt="a video of the trial" width="{NOTEBOOK_WIDTH_PX}" src="{source}">'


def video(log: TrialLog, path: Path | None) -> Video:
    """Create a video of a trial.

    Args:
        log: The trial.
        path: The file to write. None for a video that is only shown in a notebook: a WebP that is
            NOTEBOOK_WIDTH_PX wide.

    Raises:
        UsageError: If `check_video_file` refuses the path.
        LogError: If the file cannot be written.
    """
    if path is not None:
        write_video(log, path)
        return Video(check_video_file(path), path.read_bytes())
    with TemporaryDirectory() as folder:
        file = Path(folder, "trial.webp")
        write_video(log, file, width=NOTEBOOK_WIDTH_PX, rate=NOTEBOOK_RATE_HZ)
        return Video("webp", file.read_bytes())


def _choose_speed(duration_s: float) -> int:
    """Choose how many times faster than the trial a video plays.

    The result is the first of 1, 2, 5, 10, 20 and so on with which the video lasts at most
    DURATION_MAX_S.
    """
    speeds = (digit * 10**power for power in count() for digit in (1, 2, 5))
    return next(speed for speed in speeds if duration_s / speed <= DURATION_MAX_S)


def _write_animation(
    path: Path, pictures: Iterator[Picture], image_count: int, rate: int, hold_images: int
) -> None:
    """Write a video that repeats for ever as GIF or WebP.

    Args:
        path: The file.
        pictures: The images.
        image_count: Number of images.
        rate: Images per second.
        hold_images: For how many more intervals the last image is shown.
    """
    interval_ms = round(1000 / rate)
    durations_ms = [interval_ms] * (image_count - 1) + [interval_ms * (1 + hold_images)]
    images = map(Image.fromarray, pictures)
    first_image = next(images)
    options: dict[str, Any] = {"quality": 80, "method": 1, "kmin": 25, "kmax": 50}
    if path.suffix.lower() == ".gif":
        palette = first_image.quantize(256, dither=Image.Dither.NONE)
        to_palette = partial(Image.Image.quantize, palette=palette, dither=Image.Dither.NONE)
        first_image = to_palette(first_image)
        images = map(to_palette, images)
        options = {"optimize": False, "disposal": 1}
    first_image.save(
        path, save_all=True, append_images=images, duration=durations_ms, loop=0, **options
    )


def _write_mp4(path: Path, pictures: Iterator[Picture], rate: int, hold_images: int) -> None:
    """Write a video as MP4.

    Args:
        path: The file.
        pictures: The images.
        rate: Images per second.
        hold_images: Number of times that the last image is repeated.

    Raises:
        OSError: If ffmpeg fails, with the last line that it printed.
    """
    image = next(pictures)
    command = [
        "ffmpeg", "-y", "-loglevel", "error",
        "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{image.shape[1]}x{image.shape[0]}",
        "-r", str(rate), "-i", "-",
        "-c:v", "libx264", "-preset", "veryfast", "-crf", "20", "-pix_fmt", "yuv420p",
        "-movflags", "+faststart", "-fflags", "+bitexact", "-f", "mp4", str(path),
    ]  # fmt: skip
    with Child(command, has_stdin=True) as encoder:
        with suppress(BrokenPipeError):  # ffmpeg has ended, and its error message says why
            encoder.stdin.write(image.tobytes())
            for image in pictures:
                encoder.stdin.write(image.tobytes())
            encoder.stdin.write(image.tobytes() * hold_images)
            encoder.stdin.close()
        if encoder.wait() != 0:
            raise OSError((encoder.error_lines() or ["ffmpeg failed"])[-1])


def _create_figure(arena: Bounds, width_px: int) -> tuple[Figure, Axes, Axes, Axes]:
    """Create an empty image of the video for an arena, with its axes.

    The three axes are for the scene on the left, for the curve of the error at the upper right, and
    for the numbers below it. Width and height are even numbers [px], as MP4 requires.
    """
    in_per_unit = min(SCENE_WIDTH_IN / arena.width, SCENE_HEIGHT_IN / arena.height)
    scene_width_in = in_per_unit * arena.width
    scene_height_in = in_per_unit * arena.height
    width_in = scene_width_in + SIDE_WIDTH_IN + 1.36
    dpi = 2 * round(width_px / 2) / width_in
    height_min_in = max(scene_height_in, SIDE_HEIGHT_IN) + 0.75
    height_in = 2 * round(height_min_in * dpi / 2) / dpi
    figure = Figure((width_in, height_in), dpi)

    def add_axes(
        left_in: float, bottom_in: float, axes_width_in: float, axes_height_in: float
    ) -> Axes:
        """Add axes in a rectangle of the image.

        Args:
            left_in: Left edge of the rectangle [in].
            bottom_in: Lower edge of the rectangle [in].
            axes_width_in: Width of the rectangle [in].
            axes_height_in: Height of the rectangle [in].
        """
        rectangle = (
            left_in / width_in,
            bottom_in / height_in,
            axes_width_in / width_in,
            axes_height_in / height_in,
        )
        return figure.add_axes(rectangle)

    top_in = height_in - TOP_IN
    curve_bottom_in = 0.56 * height_in
    side_left_in = scene_width_in + 2 * LABELS_IN
    scene = add_axes(LABELS_IN, top_in - scene_height_in, scene_width_in, scene_height_in)
    curve = add_axes(side_left_in, curve_bottom_in, SIDE_WIDTH_IN, top_in - curve_bottom_in)
    numbers = add_axes(side_left_in, 0.1, SIDE_WIDTH_IN, curve_bottom_in - 0.7)
    return figure, scene, curve, numbers


class _Scene:
    """The part of the video that shows the robots in their arena, with their plan and trails."""

    def __init__(self, axes: Axes, log: TrialLog, colors: list[str]) -> None:
        setup = log.start.setup
        draw_scene(axes, [setup], colors, [log.positions])
        half_length_min = BODY_FRACTION_MIN * setup.arena.longer_side
        self._half_length = max(setup.wheel_radius or 0.0, half_length_min)
        self._plans: list[Line2D] = []
        self._trails: list[Line2D] = []
        self._bodies: list[Polygon] = []
        self.artists: list[Artist] = []  # what moves, in order of depth
        for color in colors:
            (plan,) = axes.plot([], [], ".", color=color, ms=2.5, mew=0)
            (trail,) = axes.plot([], [], color=color, lw=1.3)
            body = Polygon(np.zeros((4, 2)), fc=color, ec="white", lw=0.6)
            axes.add_patch(body)
            self._plans.append(plan)
            self._trails.append(trail)
            self._bodies.append(body)
            self.artists += [plan, trail, body]

    def show(self, moment: Moment) -> None:
        """Move the robots to their poses at an instant of the trial."""
        step = _followed_step(moment)
        trail = moment.trail[:: max(1, len(moment.trail) // TRAIL_POINTS)]
        for robot, (x, y, heading) in enumerate(moment.poses):
            self._plans[robot].set_data(*(step.plan.path[:, robot, :2].T if step else ([], [])))
            self._trails[robot].set_data(*np.vstack([trail[:, robot], [x, y]]).T)
            corners = self._half_length * ROBOT_CORNERS * np.exp(1j * heading)
            self._bodies[robot].set_xy(np.column_stack([x + corners.real, y + corners.imag]))


class _ErrorCurve:
    """The curve of the total error in the video: all of it in grey, up to the instant in colour."""

    def __init__(self, axes: Axes, recording: Recording) -> None:
        self._times_s = (recording.step_ns - recording.log.began_ns) / SECOND
        axes.plot(self._times_s, recording.totals, color=style.FAINT, lw=1.2)
        axes.set_xlim(0, max(recording.log.elapsed_s(recording.end_ns), 1e-9))
        axes.set_ylim(0, 1.05 * float(np.nanmax(recording.totals, initial=1e-9)))
        unit = format_unit(recording.log.start.setup.unit)
        axes.set(xlabel="time [s]", ylabel=f"total error [{unit}]")
        (self.line,) = axes.plot([], [], color=style.WHOLE, lw=1.5)

    def show(self, moment: Moment) -> None:
        """Draw the coloured part of the curve, up to an instant of the trial and its error."""
        times_s = self._times_s[: len(moment.totals)]
        self.line.set_data(
            np.append(times_s, moment.time_s), np.append(moment.totals, _total_error(moment))
        )


class _Numbers:
    """The text of the video: time, plan and error at an instant, then the error of each robot.

    The direction u is shown as an arrow.
    """

    def __init__(self, axes: Axes, names: tuple[str, ...], colors: list[str]) -> None:
        self._names = robot_labels(names) if len(names) < NUMBERED_MIN else []
        axes.set_axis_off()
        line_colors = [style.INK, style.INK, style.INK, *colors[: len(self._names)]]
        rows = max(len(line_colors), 7)
        heights = 0.92 - np.arange(len(line_colors)) / rows
        text_style: dict[str, Any] = {
            "fontsize": 8.5, "transform": axes.transAxes, "in_layout": False,
        }  # fmt: skip
        self.lines = [
            axes.text(-0.2, float(height), "", color=line_color, **text_style)
            for height, line_color in zip(heights, line_colors, strict=True)
        ]
        dial = axes.inset_axes((0.8, 0.85, 0.2, 0.22))
        dial.set(xlim=(-1.2, 1.2), ylim=(-1.2, 1.2), aspect="equal")
        dial.set_axis_off()
        dial.text(-1.6, 0, "$u$", ha="right", va="center")
        (self.arrow,) = dial.plot([], [], color=style.WHOLE, lw=1.4, clip_on=False)

    def show(self, moment: Moment) -> None:
        """Write the numbers of an instant of the trial, and turn the arrow to the plan's direction.

        There is no arrow before the first step, at the end, or if the plan has no direction.
        """
        step = _followed_step(moment)
        direction = None if step is None else step.plan.direction
        arrow = np.zeros(0) if direction is None else ARROW_POINTS * np.exp(1j * direction)
        self.arrow.set_data(arrow.real, arrow.imag)
        for line, line_text in zip(self.lines, self._lines_at(moment), strict=True):
            line.set_text(line_text)

    def _lines_at(self, moment: Moment) -> list[str]:
        """Return the text of each line at an instant of the trial.

        The lines are the time, the plan, the total error, and the error of each robot. The line of
        the plan is empty without a plan.
        """
        unit = format_unit(moment.setup.unit)
        step = moment.step
        time_text = f"{moment.time_s:.1f} s"
        plan = ""
        if step is not None:
            time_text += f", step {step.k}"
        if step is not None and not step.plan.pauses:
            plan = f"{len(step.plan.signals)} signals planned, J {step.plan.cost:.3g} {unit}"
        total = f"total error {_total_error(moment):.1f} {unit}, {moment.pose_kind}"
        robots = [
            f"{name} {distance:.1f} {unit}"
            for name, distance in zip(self._names, moment.distances, strict=False)
        ]
        return [time_text, plan, total, *robots]


def _followed_step(moment: Moment) -> Step | None:
    """Return the control step whose plan the robots follow.

    The result is None before the first step and at the end.
    """
    return None if moment.result else moment.step


def _total_error(moment: Moment) -> float:
    """Compute the sum of the robots' distances to their targets [length unit].

    An unknown distance counts as 0.
    """
    return float(np.nansum(moment.distances))


class VideoFrames:
    """The images of a video of a trial, drawn as arrays of pixels (height, width, 3).

    Height and width are even.

    Raises:
        LogError: If the log has no control steps.
    """

    @style.styled()
    def __init__(self, log: TrialLog, width: int) -> None:
        require_steps(log)
        self.recording = Recording(log)
        setup = log.start.setup
        colors = robot_colors(setup.names, setup.colors)
        figure, scene_axes, curve_axes, words_axes = _create_figure(setup.arena, width)
        self._canvas = FigureCanvasAgg(figure)
        figure.text(0.01, 0.985, _heading_text(log), va="top", color=style.GREY, fontsize=7.5)
        self._background_image = DishBackground(scene_axes, log)
        scene = _Scene(scene_axes, log, colors)
        curve = _ErrorCurve(curve_axes, self.recording)
        numbers = _Numbers(words_axes, setup.names, colors)
        self._parts = (scene, curve, numbers)
        self._moving_artists = [*scene.artists, curve.line, numbers.arrow, *numbers.lines]
        for artist in self._moving_artists:
            artist.set_animated(True)
        self._draw_background()

    def _draw_background(self) -> None:
        """Draw and keep the parts of the image that do not move."""
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(self._canvas.figure.bbox)

    def draw_at(self, elapsed_s: float) -> Picture:
        """Draw the image of an instant.

        Args:
            elapsed_s: Time since the first direction was sent [s].

        Returns:
            The image, shape (height, width, 3), with the colours red, green and blue.
        """
        time_ns = self.recording.log.began_ns + round(elapsed_s * SECOND)
        moment = self.recording.moment_at(time_ns)
        for moving_part in self._parts:
            moving_part.show(moment)
        if self._background_image.show(time_ns):
            self._draw_background()
        self._canvas.restore_region(self._background)
        renderer = self._canvas.get_renderer()
        for artist in self._moving_artists:
            artist.draw(renderer)
        return np.asarray(self._canvas.buffer_rgba())[..., :3]


def _heading_text(log: TrialLog) -> str:
    """Format the heading of the video, which names the trial and says if it is incomplete.

    The heading is cut to HEADING_LENGTH_MAX characters.
    """
    heading = f"{log.start.setup.name}, trial {log.start.trial}: {log.origin.value}"
    incompleteness = describe_incompleteness(log)
    if incompleteness:
        heading += f" ({incompleteness})"
    return heading[:HEADING_LENGTH_MAX]

"""The pictures of a film of a trial: the arena with what moves in it, and the error over time.

What does not move is drawn once; for each picture only the rest is drawn upon it.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.text import Text
from numpy.typing import NDArray

from tetractl.core.clock import SECOND
from tetractl.core.colors import robot_colors
from tetractl.core.poses import Floats
from tetractl.core.text import unit_of
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.recording import Moment, Recording
from tetractl.view import style
from tetractl.view.figures.axes import NUMBERED, need_steps, robot_labels, unfinished
from tetractl.view.figures.trajectory import draw_scene

SIZE_IN = (8.0, 5.0)
TRAIL_POINTS = 600
BODY = 0.028
"""Length of a robot's wedge where the spec gives no wheels, of the longer side of the arena."""

Picture = NDArray[np.uint8]


class Frames:
    """Draws instants of a trial; a picture is (height, width, 3), `width` pixels wide and even."""

    def __init__(self, log: TrialLog, width: int) -> None:
        need_steps(log)
        self.recording = Recording(log)
        setup = self._setup = log.start.setup
        self._colors = robot_colors(setup.names, setup.colors)
        self._heading = f"{setup.name}, trial {log.start.trial}: {log.origin.value}"
        if text := unfinished(log):
            self._heading += f" ({text})"
        with style.styled():
            figure = Figure(figsize=SIZE_IN, dpi=2 * round(width / SIZE_IN[0] / 2))
            self._canvas = FigureCanvasAgg(figure)
            arena, course = figure.subplots(
                1, 2, width_ratios=[1.5, 1], gridspec_kw={"wspace": 0.28}
            )
            figure.subplots_adjust(left=0.075, right=0.98, top=0.93, bottom=0.1)
            figure.text(0.01, 0.985, self._heading[:120], va="top", color=style.GREY, fontsize=7.5)
            self._moving = [*self._arena(arena), *self._course(course, log)]
            for artist in self._moving:
                artist.set_animated(True)
            self._canvas.draw()
            self._still = self._canvas.copy_from_bbox(figure.bbox)

    def _arena(self, axes: Axes) -> list[Line2D | Polygon]:
        setup = self._setup
        draw_scene(axes, setup, self._colors)
        axes.set_xlim(setup.arena.left, setup.arena.right)
        axes.set_ylim(setup.arena.bottom, setup.arena.top)
        longer = max(setup.arena.width, setup.arena.height)
        self._body = max(setup.wheel_radius or 0.0, BODY / 2 * longer)
        self._plans = [
            axes.plot([], [], ".", color=color, ms=2.5, mew=0, zorder=3)[0]
            for color in self._colors
        ]
        self._trails = [
            axes.plot([], [], color=color, lw=1.3, zorder=4)[0] for color in self._colors
        ]
        look = {"edgecolor": "white", "linewidth": 0.6, "zorder": 6}
        self._robots = [
            Polygon(np.zeros((4, 2)), facecolor=color, **look)  # pyright: ignore[reportArgumentType]
            for color in self._colors
        ]
        for robot in self._robots:
            axes.add_patch(robot)
        (self._arrow,) = axes.plot([], [], color=style.INK, lw=1.4, zorder=5)
        return [*self._plans, *self._trails, self._arrow, *self._robots]

    def _course(self, axes: Axes, log: TrialLog) -> list[Line2D | Text]:
        """Prepare the curve of the total error and the numbers below it."""
        setup, recording = self._setup, self.recording
        box = axes.get_position()
        axes.set_position((box.x0, 0.56, box.width, box.y1 - 0.56))
        time_s = [log.elapsed_s(int(t)) for t in recording.step_ns]
        self._times, self._totals = np.array(time_s), recording.totals
        axes.plot(time_s, self._totals, color=style.FAINT, lw=1.2)
        axes.set_xlim(0, max(recording.elapsed_s(recording.end_ns), 1e-9))
        axes.set_ylim(0, 1.05 * float(np.nanmax(self._totals, initial=1e-9)))
        axes.set_ylabel(f"total error [{unit_of(setup.unit)}]")
        axes.set_xlabel("time [s]")
        (self._curve,) = axes.plot([], [], color=style.INK, lw=1.5)
        figure = axes.get_figure(root=True)
        assert figure is not None
        names = robot_labels(setup.names) if len(setup.names) < NUMBERED else []
        self._texts = [
            figure.text(box.x0 - 0.04, 0.43 - 0.055 * row, "", color=color, fontsize=9)
            for row, color in enumerate([*[style.INK] * 3, *self._colors[: len(names)]])
        ]
        self._names = names
        return [self._curve, *self._texts]

    def at(self, elapsed_s: float) -> Picture:
        """Return the picture of a time from the first direction sent [s]."""
        now = self.recording.began_ns + round(elapsed_s * SECOND)
        moment = self.recording.at(now)
        self._show(moment)
        self._canvas.restore_region(self._still)
        renderer = self._canvas.get_renderer()
        for artist in self._moving:
            artist.draw(renderer)
        return np.asarray(self._canvas.buffer_rgba())[..., :3]

    def _show(self, moment: Moment) -> None:
        poses, trail = moment.poses, moment.trail
        thin = trail[:: max(1, len(trail) // TRAIL_POINTS)]
        plan = moment.step.plan.path if moment.step and not moment.result else None
        for robot, (x, y, heading) in enumerate(poses):
            self._trails[robot].set_data(*np.vstack([thin[:, robot], [x, y]]).T)
            self._robots[robot].set_xy(_wedge(x, y, heading, self._body))
            self._plans[robot].set_data(*(plan[:, robot, :2].T if plan is not None else ([], [])))
        self._arrow.set_data(*self._direction(moment))
        done = len(moment.totals)
        times = np.append(self._times[:done], moment.time_s)
        total = float(np.nansum(moment.distances))
        self._curve.set_data(times, np.append(self._totals[:done], total))
        unit = unit_of(self._setup.unit)
        step = moment.step
        told = [
            f"{moment.time_s:5.1f} s" + (f"   step {step.k}" if step else ""),
            f"total error {total:.1f} {unit}",
            f"plan: {len(step.plan.signals)} signals, J {step.plan.cost:.3g} {unit}"
            if step
            else "",
            *(f"{n} {e:.1f}" for n, e in zip(self._names, moment.distances, strict=False)),
        ]
        for text, words in zip(self._texts, told, strict=True):
            text.set_text(words)

    def _direction(self, moment: Moment) -> tuple[Floats, Floats]:
        """Return an arrow in the upper left corner that points as all robots are told to drive."""
        u = None if moment.step is None else moment.step.plan.direction
        if u is None or moment.result is not None:
            return np.zeros(0), np.zeros(0)
        arena = self._setup.arena
        long = 0.05 * max(arena.width, arena.height)
        middle = arena.left + 1.6 * long + 1j * (arena.top - 1.6 * long)
        head = 0.4 * long * np.exp(1j * (u + np.array([0.85, -0.85]) * np.pi))
        tip = middle + long * np.exp(1j * u)
        points = np.array([middle - long * np.exp(1j * u), tip, tip + head[0], tip, tip + head[1]])
        return np.real(points), np.imag(points)


def _wedge(x: float, y: float, heading: float, half: float) -> Floats:
    """Return the corners (4, 2) of a robot's sign, the nose first."""
    corners = np.array([1.2, -1 + 0.8j, -0.6, -1 - 0.8j]) * half * np.exp(1j * heading)
    return np.column_stack([x + corners.real, y + corners.imag])

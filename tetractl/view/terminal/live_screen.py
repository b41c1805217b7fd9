"""The live view of running trials in a terminal, updated while the control loop runs.

    events of the trial -> RunningTrial.moment --+
                                               +-> Dashboard -> Screen
    events of the batch -> footer, ResultTally ------+

In the lab, this module also prints notes, a line for each trial, and where to place robots.
"""

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Self

import numpy as np
from rich.console import Console

from tetractl.core.clock import seconds
from tetractl.core.commands import Command, Steer
from tetractl.core.plan import Plan
from tetractl.core.poses import Floats, Poses, Sample
from tetractl.core.protocols import Observer
from tetractl.core.trial import Note, Result, Start, Step
from tetractl.log.read.trial_log import Event
from tetractl.model.path_check import PathCheck
from tetractl.run.batch import Ending
from tetractl.run.task import Task
from tetractl.view.player import Moment
from tetractl.view.terminal.dashboard import Dashboard, Footer
from tetractl.view.terminal.keys import STOP_HINT
from tetractl.view.terminal.progress import ResultTally, format_duration, format_trial_line
from tetractl.view.terminal.screen import Screen

IMAGE_INTERVAL_MIN_S = 1 / 12
"""Minimum time between two images of a trial [s]."""


class RunningTrial:
    """The data of a running trial so far, from which `moment` creates its newest state.

    `Recording` does the same for a log.
    """

    def __init__(self, start: Start) -> None:
        self.start = start
        self._poses = start.setup.starts.array()
        self._path = PathCheck.for_setup(start.setup)
        self._trail: list[Floats] = []
        self._totals: list[float] = []
        self._notes: list[Note] = []
        self._step: Step | None = None
        self._result: Result | None = None
        self._now_ns = 0
        self._first_direction_ns: int | None = None

    def on_samples(self, samples: list[Sample]) -> None:
        """Add the robots' positions in new camera frames to their trails.

        The position of an untracked robot is NaN in its trail, and its shown pose stays the last
        one.
        """
        for sample in samples:
            observation = sample.observation
            poses = observation.poses.array()
            positions = np.where(observation.valid[:, None], poses[:, :2], np.nan)
            self._trail.append(positions)
            self._path.add(positions[None, :, 0], positions[None, :, 1])
            self._poses = np.where(observation.valid[:, None], poses, self._poses)
            self._now_ns = observation.sampled_ns

    def on_step(self, step: Step) -> None:
        """Store a new control step, and the total error at its time.

        The total error is the sum of the distances to the targets in the step's observation.
        """
        self.on_command(step.command)
        self._step = step
        self._now_ns = max(self._now_ns, step.command.sent_ns)
        distances = self.start.setup.distances(step.observation.poses.xy)
        self._totals.append(float(distances.sum()))

    def on_command(self, command: Command) -> None:
        """Store the time of the first command that is not a stop. Later commands change nothing."""
        if self._first_direction_ns is None and not command.stops:
            self._first_direction_ns = command.sent_ns

    def preview(self, plan: Plan, direction: float) -> None:
        """Replace the plan of the newest step by the plan of a direction [rad] that is not sent.

        Nothing happens before the first step.
        """
        if self._step is not None:
            command = replace(self._step.command, action=Steer(direction))
            self._step = replace(self._step, plan=plan, command=command)

    def on_note(self, note: Note) -> None:
        """Store an event of the trial."""
        self._notes.append(note)

    def on_stop(self, stop: Command, result: Result) -> None:
        """Store the result of the trial."""
        self._result = result

    def warnings(self) -> tuple[str, ...]:
        """Describe which robots have failed the trial, and why.

        A robot has failed if it has entered an obstacle or left the arena. If a robot is outside
        now, the text states on which side and how far.
        """
        setup = self.start.setup
        verdict = self._path.verdict(Poses.from_array(self._poses))
        names = np.array(setup.names)
        entered = [f"{name} entered an obstacle: lost" for name in names[verdict.in_obstacle()]]
        outside = [
            f"{names[robot]} {self._describe_exit(robot)}"
            for robot in np.flatnonzero(verdict.over_edge()).tolist()
        ]
        return (*entered, *outside)

    def _describe_exit(self, robot: int) -> str:
        """Describe where and how far outside the arena a robot is, or that it has been outside."""
        arena = self.start.setup.arena
        x, y = self._poses[robot, :2]
        excess_by_side = {
            "left": arena.left - x,
            "right": x - arena.right,
            "below": arena.bottom - y,
            "above": y - arena.top,
        }
        direction = max(excess_by_side, key=lambda side: excess_by_side[side])
        if excess_by_side[direction] <= 0:
            return "left the arena: lost"
        return (
            f"is outside: lost, {excess_by_side[direction]:.4g} {self.start.setup.unit} {direction}"
        )

    def moment(self) -> Moment:
        """Create the trial's present state for a view. Times count from the first direction."""
        setup = self.start.setup
        began_ns = self._first_direction_ns
        if began_ns is None:
            began_ns = self._now_ns
        events = (
            Event(seconds(note.t_ns - began_ns), note.level, note.text) for note in self._notes
        )
        return Moment(
            setup=setup,
            time_s=self._result.duration_s if self._result else seconds(self._now_ns - began_ns),
            end_s=None,
            poses=self._poses,
            trail=np.array(self._trail).reshape(-1, len(setup.names), 2),
            step=self._step,
            totals=np.array(self._totals),
            steps_total=0,
            result=self._result,
            events=tuple(events),
            pose_kind="true" if self._result and self.start.plant.simulated else "measured",
        )


class LiveView(Observer):
    """A view of running trials, one after another, on the terminal. It is a context manager.

    The view is an `Observer` of each trial and a `RunObserver`. It draws at most 12 images per
    second, and nothing while its screen is closed.

    Args:
        console: The terminal.
        wall: Returns the wall time [s].
        hints: What the keys do, if they do more than stop the robots.
        side_text: Text shown instead of the results so far. Empty for the results.
        steered_by_hand: Whether a person steers by hand. The view then also warns of obstacles and
            edges, and does not show the number of the trial.
    """

    def __init__(
        self,
        console: Console,
        wall: Callable[[], float] = time.monotonic,
        hints: tuple[str, ...] = (),
        side_text: str = "",
        steered_by_hand: bool = False,
    ) -> None:
        self._wall = wall
        self._hints = hints
        self._side_text = side_text
        self._steered_by_hand = steered_by_hand
        self._screen = Screen(console)
        self._tally = ResultTally()
        self._task: Task | None = None
        self._trial: RunningTrial | None = None
        self._drawn_s = -np.inf

    def __enter__(self) -> Self:
        self._screen.open()
        return self

    def __exit__(self, *error: object) -> None:
        self._screen.close()

    def trial_started(self, task: Task) -> None:
        """Take note of the number of the trial that begins, and of the number of trials.

        The first trial also starts the clock from which the remaining time is estimated.
        """
        if self._task is None:
            self._tally.began_s = self._wall()
        self._task = task

    def trial_ended(self, ending: Ending) -> None:
        """Add the result of the trial that has ended to the summary of all trials."""
        if ending.result:
            self._tally.add(ending.result)

    def on_start(self, start: Start) -> None:
        """Show the start of a new trial."""
        self._trial = RunningTrial(start)
        self._draw()

    def on_samples(self, samples: list[Sample]) -> None:
        """Add the robots' positions in new camera frames to the view."""
        self._running_trial.on_samples(samples)
        self._draw_in_time()

    def on_step(self, step: Step) -> None:
        """Show a new control step."""
        self._running_trial.on_step(step)
        self._draw_in_time()

    def on_command(self, command: Command) -> None:
        """Pass a command on to the trial's state. It shows only by its effect on the robots."""
        self._running_trial.on_command(command)

    def on_note(self, note: Note) -> None:
        """Show a new note of the trial in the list of events."""
        self._running_trial.on_note(note)
        self._draw_in_time()

    def on_stop(self, stop: Command, result: Result) -> None:
        """Show the outcome of the trial."""
        self._running_trial.on_stop(stop, result)
        self._draw()

    def show_text(self, side_text: str, *hints: str) -> None:
        """Show a text beside the last image, with other hints, in the style for steering by hand.

        Later images keep this style and this text.
        """
        self._side_text = side_text
        self._hints = hints
        self._steered_by_hand = True
        self._draw()

    def preview(self, plan: Plan, direction: float) -> None:
        """Show where robots would go under a plan whose direction [rad] is not sent."""
        self._running_trial.preview(plan, direction)
        self._draw()

    @property
    def _running_trial(self) -> RunningTrial:
        assert self._trial is not None, "a trial's first message is its start"
        return self._trial

    def _draw_in_time(self) -> None:
        if self._wall() - self._drawn_s >= IMAGE_INTERVAL_MIN_S:
            self._draw()

    def _draw(self) -> None:
        if not self._screen.is_open:
            return
        self._drawn_s = self._wall()
        start = self._running_trial.start
        hints = self._hints or ("Ctrl-C stops" if start.plant.virtual else STOP_HINT,)
        self._screen.show(
            Dashboard(
                self._running_trial.moment(),
                heading=f"{start.setup.name}, {start.plant.kind}",
                footer=Footer("", 0, "", hints) if self._steered_by_hand else self._footer(hints),
                notes=self._running_trial.warnings() if self._steered_by_hand else (),
                side_text=self._side_text or self._tally.summary(start.setup.unit),
                steered_by_hand=self._steered_by_hand,
            )
        )

    def _footer(self, hints: tuple[str, ...]) -> Footer:
        """Return the lowest line: the number of the trial, and how long the others will take.

        Trials count from 1. The time is left out until a trial has ended.
        """
        n_ended = len(self._tally.errors)
        n_trials = 1 if self._task is None else self._task.trial_count
        number = 1 if self._task is None else self._task.trial + 1
        elapsed_s = self._wall() - self._tally.began_s
        time_left = ""
        if n_ended and elapsed_s:
            time_left = f"{format_duration(elapsed_s / n_ended * (n_trials - n_ended))} left"
        return Footer(f"trial {number} of {n_trials}", n_ended / n_trials, time_left, hints)


class TerminalPrompt:
    """A prompt at the terminal that asks a person to place robots.

    It prints where the robots must stand, and notices when the person presses Enter.
    """

    def __init__(self, console: Console, entered: threading.Event) -> None:
        self._console = console
        self._entered = entered
        self._shown: tuple[Sequence[str], Sequence[str]] | None = None

    def place(self, lines: Sequence[str], questions: Sequence[str] = ()) -> None:
        """Print where robots must stand, with questions, unless the text is the same as before.

        A new text discards earlier presses of Enter.

        Args:
            lines: Where each misplaced robot must stand. Empty if all robots stand on their starts.
            questions: Questions that the person must answer with yes before the start.
        """
        if (lines, questions) != self._shown:
            self._shown = lines, questions
            self._entered.clear()
            ready_text = "all robots stand on their starts: press Enter to start"
            ready_text += ", if your answers are yes" if questions else ""
            for line in (*questions, "; ".join(lines) or ready_text):
                self._console.print(line, highlight=False, markup=False, soft_wrap=True)

    def go(self) -> bool:
        """Return whether the person has pressed Enter since the last text was printed.

        If so, the key press is used up, and the next text is printed even if it is the same.
        """
        if not self._entered.is_set():
            return False
        self._entered.clear()
        self._shown = None
        return True


class LabView(LiveView):
    """A view of a batch in the lab: a line for each trial and, if wanted, a live view.

    Between trials, while robots are placed, the live view is closed. It opens when a trial starts.

    Args:
        console: The console for notes and for the lines of failed trials.
        quiet: The console for the lines of other trials. It may be silent.
        unit: The length unit.
        live: Whether to show a live view.
        hints: What keys do, if they do more than stop the robots.
        side_text: Shown instead of the results so far.
    """

    def __init__(
        self,
        console: Console,
        quiet: Console,
        unit: str,
        live: bool,
        hints: tuple[str, ...] = (),
        side_text: str = "",
    ) -> None:
        super().__init__(console, hints=hints, side_text=side_text)
        self._console = console
        self._quiet = quiet
        self._unit = unit
        self._wanted = live
        self._unprinted: list[Note] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._show_lines()

    def trial_ended(self, ending: Ending) -> None:
        """Close the live view and print the notes. Also print the result, if the trial has one."""
        super().trial_ended(ending)
        self._show_lines()
        if ending.result:
            line = format_trial_line(ending.task, ending.result, self._unit)
            console = self._console if ending.failure else self._quiet
            console.print(line, highlight=False, markup=False, soft_wrap=True)

    def on_start(self, start: Start) -> None:
        """Open the live view of a new trial, if it is wanted, and show the trial's start."""
        if self._wanted:
            self._screen.open()
        super().on_start(start)

    def on_note(self, note: Note) -> None:
        """Print a note, or keep it until the live view is closed.

        Notes of the level "debug", the lines of a traceback, are left out.
        """
        if note.level == "debug":
            return
        self._unprinted.append(note)
        if self._screen.is_open:
            super().on_note(note)
        else:
            self._print_notes()

    def _show_lines(self) -> None:
        """Close the live view, and print the events of its trial."""
        self._screen.close()
        self._print_notes()

    def _print_notes(self) -> None:
        for note in self._unprinted:
            line = f"{note.level}: {note.text}"
            self._console.print(line, highlight=False, markup=False, soft_wrap=True)
        self._unprinted.clear()

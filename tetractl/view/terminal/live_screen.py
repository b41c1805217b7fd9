"""The live view of running trials: the dashboard, drawn while the loop runs.

In the lab it also prints notes, a line per trial, and where to place robots.
"""

import threading
import time
from collections.abc import Callable, Sequence
from typing import Self

import numpy as np
from rich.console import Console
from rich.live import Live

from tetractl.core.clock import seconds
from tetractl.core.colors import robot_colors
from tetractl.core.commands import Command, Note, Sample
from tetractl.core.poses import Floats
from tetractl.core.protocols import Observer
from tetractl.core.trial import Result, Start, Step
from tetractl.log.read.trial_log import Event
from tetractl.replay.player import Moment, tracked
from tetractl.run.batch import Ending
from tetractl.run.task import Task
from tetractl.view.terminal.dashboard import Dashboard, Footer
from tetractl.view.terminal.keys import SAYS
from tetractl.view.terminal.progress import Tally, duration, trial_line


class LiveView(Observer):
    """Shows one trial after another on the alternate screen: an `Observer` of each trial and a
    `RunObserver`; a context manager.

    It draws at most 12 pictures per second; `wall` returns the wall time [s]. While its screen is
    closed, it draws nothing.
    """

    def __init__(self, console: Console, wall: Callable[[], float] = time.monotonic) -> None:
        self._wall = wall
        self._live = Live(
            console=console, screen=True, auto_refresh=False, redirect_stdout=False, transient=True
        )
        self._tally = Tally()
        self._index, self._count = 0, 1
        self._began: float | None = None
        self._drawn = -np.inf
        self._notes: list[Note] = []

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._live.stop()

    def trial_started(self, task: Task) -> None:
        """Store the trial's number and the number of trials."""
        self._index, self._count = task.trial, task.count
        if self._began is None:
            self._began = self._wall()

    def trial_ended(self, ending: Ending) -> None:
        """Add the trial to the counts."""
        if ending.result:
            self._tally.add(ending.result)

    def on_start(self, start: Start) -> None:
        """Clear the view for a new trial."""
        setup = self._setup = start.setup
        self._plant, self._true = start.plant.kind, start.plant.simulated
        virtual = start.plant.virtual
        self._hints = ("Ctrl-C stops",) if virtual else (SAYS,)
        self._colors = robot_colors(setup.names, setup.colors)
        self._poses = setup.starts.array()
        self._trail: list[Floats] = []
        self._totals: list[float] = []
        self._step: Step | None = None
        self._result: Result | None = None
        self._time_ns = 0
        self._first_ns: int | None = None  # when the first direction was sent
        self._notes = []
        self._draw()

    def on_samples(self, samples: list[Sample]) -> None:
        """Add camera frames to the trails."""
        for sample in samples:
            seen = sample.observation
            poses = seen.poses.array()
            self._trail.append(tracked(poses[None], seen.valid[None])[0])
            self._poses = np.where(seen.valid[:, None], poses, self._poses)
            self._time_ns = seen.sampled_ns
        self._draw_in_time()

    def on_step(self, step: Step) -> None:
        """Show the control step."""
        self.on_command(step.command)
        self._step = step
        self._time_ns = max(self._time_ns, step.command.sent_ns)
        self._totals.append(float(self._setup.distances(step.observation.poses.xy).sum()))
        self._draw_in_time()

    def on_command(self, command: Command) -> None:
        """Store the time of the first direction; the command's effect shows in the trails."""
        if self._first_ns is None and not command.stops:
            self._first_ns = command.sent_ns

    def on_note(self, note: Note) -> None:
        """Show the note in the list of events."""
        self._notes.append(note)
        self._draw_in_time()

    def on_stop(self, stop: Command, result: Result) -> None:
        """Show the outcome."""
        self._result = result
        self._draw()

    def _draw_in_time(self) -> None:
        if self._wall() - self._drawn >= 1 / 12:
            self._draw()

    def _draw(self) -> None:
        if not self._live.is_started:
            return
        self._drawn = self._wall()
        self._live.update(self._dashboard(), refresh=True)

    def _dashboard(self) -> Dashboard:
        setup = self._setup
        first_ns = self._time_ns if self._first_ns is None else self._first_ns
        frame = Moment(
            setup=setup,
            time_s=seconds(self._time_ns - first_ns),
            end_s=None,
            poses=self._poses,
            trail=np.array(self._trail).reshape(-1, len(setup.names), 2),
            step=self._step,
            totals=np.array(self._totals),
            steps_end=0,
            result=self._result,
            events=tuple(
                Event(seconds(note.t_ns - first_ns), note.level, note.text) for note in self._notes
            ),
            known="true" if self._result and self._true else "measured",
        )
        done, n = len(self._tally.errors), self._count
        taken_s = self._wall() - self._began if self._began is not None else 0.0
        footer = Footer(
            left=f"trial {self._index + 1} of {n}",
            fraction=done / n,
            right=f"{duration(taken_s / done * (n - done))} left" if done and taken_s else "",
            hints=self._hints,
        )
        heading = f"{setup.name}, {self._plant}"
        so_far = self._tally.summary(setup.unit)
        return Dashboard(frame, self._colors, heading, footer, aside=so_far)


class TerminalPrompt:
    """A `PlacementPrompt` at the terminal: prints where robots must stand, and waits for Enter."""

    def __init__(self, console: Console, entered: threading.Event) -> None:
        self._console, self._entered = console, entered
        self._shown: tuple[Sequence[str], Sequence[str]] | None = None

    def place(self, lines: Sequence[str], questions: Sequence[str] = ()) -> None:
        """Print the lines and questions if they differ from those last printed."""
        if (lines, questions) != self._shown:
            self._shown = lines, questions
            self._entered.clear()
            ready = "all robots stand on their starts: press Enter to go"
            ready += ", if your answers are yes" if questions else ""
            for text in (*questions, "; ".join(lines) or ready):
                self._console.print(text, highlight=False, markup=False, soft_wrap=True)

    def go(self) -> bool:
        """Return whether Enter was pressed since the lines were last printed."""
        if not self._entered.is_set():
            return False
        self._entered.clear()
        self._shown = None
        return True


class LabWatch(LiveView):
    """Shows a batch in the lab: a line per trial and, if `live`, a live view of each trial.

    Notes are printed on `console`, a line per trial on `quiet`, which may be silent; `unit` is the
    length unit. Between trials, while robots are placed, the live view is closed.
    """

    def __init__(self, console: Console, quiet: Console, unit: str, live: bool) -> None:
        super().__init__(console)
        self._console, self._quiet = console, quiet
        self._unit, self._wanted = unit, live
        self._unprinted: list[Note] = []

    def trial_ended(self, ending: Ending) -> None:
        """Close the live view, and print the notes and the trial's line."""
        super().trial_ended(ending)
        self._live.stop()
        self._print_notes()
        if ending.result:
            text = trial_line(ending.task, ending.result, self._unit)
            self._quiet.print(text, highlight=False, markup=False, soft_wrap=True)

    def on_start(self, start: Start) -> None:
        """Open the live view."""
        if self._wanted:
            self._live.start()
        super().on_start(start)

    def on_note(self, note: Note) -> None:
        """Print a note, or keep it until the live view is closed; leave out calls."""
        if note.level == "debug":
            return
        self._unprinted.append(note)
        if self._live.is_started:
            super().on_note(note)
        else:
            self._print_notes()

    def _print_notes(self) -> None:
        notes, self._unprinted = self._unprinted, []
        for note in notes:
            text = f"{note.level}: {note.text}"
            self._console.print(text, highlight=False, markup=False, soft_wrap=True)

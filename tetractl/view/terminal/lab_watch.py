"""A batch in the lab at the terminal: notes, one line per trial or live views, and placing
robots."""

import threading
from collections.abc import Sequence

from rich.console import Console

from tetractl.core.commands import Command, Note, Sample
from tetractl.core.trial import Result, Start, Step
from tetractl.run.batch import Ending
from tetractl.run.task import Task
from tetractl.view.terminal.live_screen import LiveView
from tetractl.view.terminal.progress import trial_line


class TerminalPrompt:
    """A `PlacementPrompt` at the terminal: prints where robots must go, and waits for Enter."""

    def __init__(self, console: Console, entered: threading.Event) -> None:
        self._console, self._entered = console, entered
        self._shown: tuple[Sequence[str], Sequence[str]] | None = None

    def place(self, lines: Sequence[str], questions: Sequence[str] = ()) -> None:
        """Print the lines and questions if they have changed."""
        if (lines, questions) != self._shown:
            self._shown = lines, questions
            self._entered.clear()
            ready = "all robots stand on their starts: press Enter to go"
            ready += ", if the answer is yes" if questions else ""
            for text in (*questions, "; ".join(lines) or ready):
                self._console.print(text, highlight=False, markup=False, soft_wrap=True)

    def go(self) -> bool:
        """Return whether Enter was pressed since all robots stood."""
        if not self._entered.is_set():
            return False
        self._entered.clear()
        self._shown = None
        return True


class LabWatch:
    """Shows a batch in the lab: lines, or each trial's live view; an `Observer` and a watcher.

    Notes go to `console`, one line per trial to `quiet`, which may drop it; `unit` is the length
    unit. Between trials the live view restores the screen, for placing the robots.
    """

    def __init__(self, console: Console, quiet: Console, unit: str, live: bool) -> None:
        self._console, self._quiet = console, quiet
        self._unit, self._live = unit, live
        self._view: LiveView | None = None
        self._notes: list[Note] = []

    def trial_started(self, task: Task) -> None:
        """Note which trial comes."""
        self._task = task

    def trial_ended(self, ending: Ending) -> None:
        """Print the trial's line."""
        self._close()
        if ending.result:
            text = trial_line(ending.task, ending.result, self._unit)
            self._quiet.print(text, highlight=False, markup=False, soft_wrap=True)

    def on_start(self, start: Start) -> None:
        """Open the live view."""
        if self._live:
            self._view = LiveView(self._console)
            self._view.__enter__()
            self._view.trial_started(self._task)
            self._view.on_start(start)

    def on_samples(self, samples: list[Sample]) -> None:
        """Show camera frames in the live view."""
        if self._view:
            self._view.on_samples(samples)

    def on_step(self, step: Step) -> None:
        """Show a control step in the live view."""
        if self._view:
            self._view.on_step(step)

    def on_command(self, command: Command) -> None:
        """Do nothing: a command shows in what the robots do."""

    def on_note(self, note: Note) -> None:
        """Print a note, after the live view if there is one."""
        self._notes.append(note)
        if not self._view:
            self._print_notes()

    def on_stop(self, stop: Command, result: Result) -> None:
        """Show how it ended."""
        if self._view:
            self._view.on_stop(stop, result)

    def _close(self) -> None:
        if self._view:
            self._view.__exit__(None, None, None)
            self._view = None
        self._print_notes()

    def _print_notes(self) -> None:
        notes, self._notes = self._notes, []
        for note in notes:
            text = f"{note.level}: {note.text}"
            self._console.print(text, highlight=False, markup=False, soft_wrap=True)

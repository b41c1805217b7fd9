"""What `tetractl run` adds in the lab: the operator's stop, placing robots, recording the wire."""

import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from tetractl.core.commands import Command, Note, Sample
    from tetractl.core.trial import Result, Start, Step
    from tetractl.experiment.experiment import Experiment
    from tetractl.experiment.load import LoadedSpec
    from tetractl.lab.wire_tap import Tap
    from tetractl.plant.lab import Hands
    from tetractl.run.batch import Report
    from tetractl.run.interrupt import Interrupt
    from tetractl.view.terminal.live import LiveView


def run_in_lab(
    loaded: "LoadedSpec",
    folder: Path,
    todo: list[int],
    console: "Console",
    interrupt: "Interrupt",
    live: bool,
    record: Path | None,
) -> "Report":
    """Run trials in the lab; the terminal's space bar and Esc stop the robots at any time."""
    from rich.console import Console

    from tetractl.lab.recorder import WireRecorder
    from tetractl.plant.lab import Hands
    from tetractl.run.batch import run_batch
    from tetractl.view.terminal.stopkey import SAYS, StopKey

    quiet, console = console, Console(stderr=True)  # what concerns safety is always said
    operator, entered = threading.Event(), threading.Event()
    with ExitStack() as stack:
        key = stack.enter_context(StopKey(operator.set, entered.set))
        says = SAYS if key.listening else "no terminal: there is no key to stop the robots"
        console.print(says, style="bold", highlight=False)
        live = live and key.listening
        watch = LabWatch(console, quiet, loaded.experiment, live)
        attendant = TerminalAttendant(console, entered) if key.listening else None

        @contextmanager
        def hands(trial: int) -> "Iterator[Hands]":
            with ExitStack() as inner:
                tap = _recorder(inner, record, trial)
                yield Hands(operator, attendant, tap, lambda: interrupt.requested)
                if isinstance(tap, WireRecorder) and tap.error:
                    console.print(f"{tap.path}: recording ended: {tap.error}", highlight=False)

        return run_batch(loaded, folder, todo, 1, interrupt, watch, [watch], hands)


def _recorder(stack: ExitStack, folder: Path | None, trial: int) -> "Tap":
    from tetractl.lab.recorder import WireRecorder
    from tetractl.lab.wire_tap import NO_TAP

    if folder is None:
        return NO_TAP
    folder.mkdir(parents=True, exist_ok=True)
    return stack.enter_context(WireRecorder(folder / f"trial-{trial:03d}.wire"))


class TerminalAttendant:
    """Tells the person at the terminal where robots must go, and waits for Enter."""

    def __init__(self, console: "Console", entered: threading.Event) -> None:
        self._console, self._entered = console, entered
        self._said: list[str] | None = None

    def place(self, lines: list[str]) -> None:
        """Print what has changed."""
        if lines != self._said:
            self._said = lines
            self._entered.clear()
            text = "; ".join(lines) or "all robots stand on their starts: press Enter to go"
            self._console.print(text, highlight=False, markup=False, soft_wrap=True)

    def go(self) -> bool:
        """Whether Enter was pressed since all robots stood."""
        if not self._entered.is_set():
            return False
        self._entered.clear()
        self._said = None
        return True


class LabWatch:
    """Shows a batch in the lab: lines, or each trial's live view; an `Observer` and a watcher.

    Notes go to `console`, a line a trial to `quiet`, which may drop it.

    The live view's screen is given back between trials, for placing the robots.
    """

    def __init__(
        self, console: "Console", quiet: "Console", experiment: "Experiment", live: bool
    ) -> None:
        self._console, self._quiet = console, quiet
        self._unit, self._live = experiment.units.length, live
        self._view: LiveView | None = None
        self._notes: list[Note] = []
        self._trial = self._count = 0

    def trial_started(self, index: int, n: int) -> None:
        """Note which trial comes."""
        self._trial, self._count = index, n

    def trial_finished(self, index: int, result: "Result") -> None:
        """Print the trial's line."""
        from tetractl.view.terminal.progress import trial_line

        self._close()
        text = trial_line(index, self._count, result, self._unit)
        self._quiet.print(text, highlight=False, markup=False, soft_wrap=True)

    def on_start(self, start: "Start") -> None:
        """Open the live view."""
        if self._live:
            from tetractl.view.terminal.live import LiveView

            self._view = LiveView(self._console)
            self._view.__enter__()
            self._view.trial_started(self._trial, self._count)
            self._view.on_start(start)

    def on_samples(self, samples: "list[Sample]") -> None:
        """Show them."""
        if self._view:
            self._view.on_samples(samples)

    def on_step(self, step: "Step") -> None:
        """Show it."""
        if self._view:
            self._view.on_step(step)

    def on_command(self, command: "Command") -> None:
        """Commands show in what the robots do."""

    def on_note(self, note: "Note") -> None:
        """Print it, after the live view where there is one."""
        self._notes.append(note)
        if not self._view:
            self._print_notes()

    def on_stop(self, stop: "Command", result: "Result") -> None:
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

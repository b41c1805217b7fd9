"""A run in the lab: the operator's stop, and placing the robots on their starts."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from tetractl.core.protocols import LabSupervision, Observer
    from tetractl.run.batch import Report, TrialStore
    from tetractl.run.interrupt import Interrupt
    from tetractl.run.task import Task


def run_in_lab(
    tasks: "list[Task]",
    store: "TrialStore",
    unit: str,
    console: "Console",
    interrupt: "Interrupt",
    live: bool,
    yes: bool,
    served: "Sequence[Observer]" = (),
    unattended: bool = False,
) -> "Report":
    """Run trials in the lab; the terminal's space bar and Esc stop the robots at any time.

    A person at the terminal starts each trial, unless `yes`. If `unattended`, the robots are not
    stopped when the terminal closes.
    """
    from rich.console import Console

    from tetractl.core.protocols import LabSupervision
    from tetractl.run.batch import run_batch
    from tetractl.run.executors import Here
    from tetractl.view.terminal.keys import SAYS, StopKey
    from tetractl.view.terminal.live_screen import LabWatch, TerminalPrompt

    quiet, console = console, Console(stderr=True)  # messages on safety are always printed
    emergency, entered = threading.Event(), threading.Event()
    with StopKey(emergency.set, entered.set, unattended) as key:
        says = SAYS if key.listening else "no terminal: there is no key to stop the robots"
        console.print(says, style="bold", highlight=False)
        watch = LabWatch(console, quiet, unit, live and key.listening)
        prompt = None if yes or not key.listening else TerminalPrompt(console, entered)

        @contextmanager
        def supervision(trial: int) -> "Iterator[LabSupervision]":
            yield LabSupervision(emergency, prompt, lambda: interrupt.requested)

        executor = Here(interrupt, [watch, *served], supervision)
        return run_batch(tasks, store, executor, watch, fail_fast=True)

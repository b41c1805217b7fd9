"""What a run adds in the lab: the operator's stop, placing the robots, recording the wire."""

import gc
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from tetractl.core.protocols import Observer
    from tetractl.core.supervision import LabSupervision
    from tetractl.core.wire_tap import Tap
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
    record: Path | None,
    yes: bool,
    served: "Sequence[Observer]" = (),
    unattended: bool = False,
) -> "Report":
    """Run trials in the lab; the terminal's space bar and Esc stop the robots at any time.

    A person at the terminal starts each trial, unless `yes`. `unattended`: a terminal that goes
    away stops nothing.
    """
    from rich.console import Console

    from tetractl.core.supervision import LabSupervision
    from tetractl.lab.recorder import WireRecorder
    from tetractl.run.batch import run_batch
    from tetractl.run.executors import Here
    from tetractl.view.terminal.lab_watch import LabWatch, TerminalPrompt
    from tetractl.view.terminal.stopkey import SAYS, StopKey

    quiet, console = console, Console(stderr=True)  # what concerns safety is always said
    emergency, entered = threading.Event(), threading.Event()
    with StopKey(emergency.set, entered.set, unattended) as key:
        says = SAYS if key.listening else "no terminal: there is no key to stop the robots"
        console.print(says, style="bold", highlight=False)
        watch = LabWatch(console, quiet, unit, live and key.listening)
        prompt = None if yes or not key.listening else TerminalPrompt(console, entered)

        @contextmanager
        def supervision(trial: int) -> "Iterator[LabSupervision]":
            with ExitStack() as stack:
                tap = _recorder(stack, record, trial)
                yield LabSupervision(emergency, prompt, tap, lambda: interrupt.requested)
                if isinstance(tap, WireRecorder) and tap.error:
                    console.print(f"{tap.path}: recording ended: {tap.error}", highlight=False)

        gc.collect()
        gc.freeze()  # so that collecting what was imported never delays the inner loop
        executor = Here(interrupt, [watch, *served], supervision)
        return run_batch(tasks, store, executor, watch, fail_fast=True)


def _recorder(stack: ExitStack, folder: Path | None, trial: int) -> "Tap":
    from tetractl.core.wire_tap import NO_TAP
    from tetractl.lab.recorder import WireRecorder

    if folder is None:
        return NO_TAP
    folder.mkdir(parents=True, exist_ok=True)
    return stack.enter_context(WireRecorder(folder / f"trial-{trial:03d}.wire"))

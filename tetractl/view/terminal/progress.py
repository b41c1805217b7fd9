"""Shows the progress of a run: on a terminal a bar with the remaining time, otherwise lines."""

import sys
import time
from collections.abc import Callable
from pkgutil import resolve_name
from typing import Any, Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from tetractl.core.trial import Result
from tetractl.run.batch import Ending, RunObserver
from tetractl.run.task import Task

STUDY_LINES = 10
"""Number of progress lines that a study prints without a terminal."""
RESULTS_TO_ESTIMATE = 3
"""Minimum number of results from which a study's duration is estimated."""
LINE_INTERVAL_S = 10.0
"""Minimum time between two progress lines of a script [s]."""
BAR_INTERVAL_S = 0.2
"""Minimum time between two changes of a notebook's bar [s]."""


class ResultTally:
    """The results of a batch's trials so far: their errors, and how many ended badly.

    Attributes:
        began_s: When the first trial began [s].
        errors: Total error of each finished trial.
        aborted: Number of aborted trials.
        entered: Number of trials in which a robot entered an obstacle.
    """

    def __init__(self) -> None:
        self.began_s = 0.0
        self.errors: list[float] = []
        self.aborted = 0
        self.entered = 0

    def add(self, result: Result) -> None:
        """Add the result of a finished trial.

        Its total error is stored even if it was aborted. Aborted trials, and trials in which a
        robot entered an obstacle, are counted separately. One trial can count as both.
        """
        self.errors.append(result.total_error)
        self.aborted += result.outcome == "aborted"
        self.entered += result.entered_obstacle

    def summary(self, unit: str) -> str:
        """Describe the finished trials in one line: mean total error, entered obstacles, aborts.

        The line is empty before the first trial has finished.
        """
        if not self.errors:
            return ""
        parts = [f"mean total error {sum(self.errors) / len(self.errors):.1f} {unit}"]
        if self.entered:
            parts.append(f"{self.entered} entered an obstacle")
        if self.aborted:
            parts.append(f"{self.aborted} aborted")
        return ", ".join(parts)


class _TrialsBar(RunObserver):
    """A progress bar of trials, shown on a terminal unless `quiet`. It is a context manager."""

    def __init__(self, console: Console, total: int, quiet: bool = False) -> None:
        self._console = console
        self._trial_count = total
        is_shown = console.is_terminal and not (console.is_dumb_terminal or console.quiet or quiet)
        self._ended_count = 0
        columns = (TextColumn("trials"), BarColumn(bar_width=30), MofNCompleteColumn())
        description = TextColumn("{task.description}")
        self._bar = (
            Progress(*columns, description, console=console, transient=True) if is_shown else None
        )

    def __enter__(self) -> Self:
        if self._bar:
            self._bar.start()
            self._task = self._bar.add_task("", total=self._trial_count)
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar:
            self._bar.stop()

    def _advance(self, *parts: str) -> None:
        self._ended_count += 1
        if self._bar:
            self._bar.update(self._task, advance=1, description=", ".join(filter(None, parts)))

    def _print_line(self, line: str) -> None:
        self._console.print(line, highlight=False, markup=False, soft_wrap=True)


class BatchProgress(_TrialsBar):
    """The progress of a batch: a bar that also shows the errors of the trials so far.

    It is a `RunObserver`. Without a terminal, it prints a line for each trial.

    Args:
        console: Where to print.
        total: Number of trials.
        unit: The experiment's length unit.
    """

    def __init__(self, console: Console, total: int, unit: str = "mm") -> None:
        super().__init__(console, total)
        self._tally = ResultTally()
        self._unit = unit

    def trial_ended(self, ending: Ending) -> None:
        """Advance the bar or, without a bar, print the trial's line if it has a result."""
        if ending.result:
            self._tally.add(ending.result)
        self._advance(_remaining_time(ending), self._tally.summary(self._unit))
        if ending.result and not self._bar:
            self._print_line(format_trial_line(ending.task, ending.result, self._unit))


class StudyProgress(_TrialsBar):
    """The progress of a study: a bar, the failures of trials, and the expected duration.

    It is a `RunObserver`. Without a terminal, it prints a line after each tenth of the trials.

    Args:
        console: Where to print.
        total: Number of trials.
        quiet: Whether to print only failures.
    """

    def __init__(self, console: Console, total: int, quiet: bool = False) -> None:
        super().__init__(console, total, quiet)
        self._quiet = quiet
        self._result_count = 0
        self._is_estimate_printed = False  # whether the expected duration was printed

    def trial_ended(self, ending: Ending) -> None:
        """Print a failure and the expected duration; advance the bar, or print a line.

        The expected duration is printed once. Without a bar, about LINES lines are printed in all.
        """
        if ending.failure:
            self._print_line(f"failed: {ending.task.arm}/{ending.task.trial}: {ending.failure}")
        if ending.result is not None:
            self._result_count += 1
        can_estimate = self._result_count >= RESULTS_TO_ESTIMATE and ending.has_time_of_each_arm
        if can_estimate and not (self._is_estimate_printed or self._quiet):
            self._is_estimate_printed = True
            if ending.remaining_s:
                basis = f"estimated from the first {self._result_count} trials"
                self._print_line(
                    f"expected duration {format_duration(ending.remaining_s)}, {basis}"
                )
        lines_before = self._lines_due()
        self._advance(_remaining_time(ending))
        if self._lines_due() > lines_before and not (self._bar or self._quiet):
            parts = (f"{self._ended_count} of {self._trial_count} trials", _remaining_time(ending))
            self._print_line(", ".join(filter(None, parts)))

    def _lines_due(self) -> int:
        """Compute how many of the STUDY_LINES should have been printed after the trials so far."""
        return self._ended_count * STUDY_LINES // self._trial_count


def create_script_progress(total: int) -> RunObserver:
    """Create the progress display of `total` trials for a script or, in a notebook, for a cell."""
    if "IPython" in sys.modules:
        shell = resolve_name("IPython:get_ipython")()
        if hasattr(shell, "kernel"):  # a terminal's shell has none
            return NotebookProgress(total, resolve_name("IPython.display:display"))
    return ScriptProgress(total)


class ScriptProgress(RunObserver):
    """The progress of trials in a script, printed to stderr as lines.

    At most every LINE_INTERVAL_S, it prints how many trials have ended, and how long the others
    will take.

    Args:
        total: Number of trials.
        now_s: Returns the time [s].
    """

    def __init__(self, total: int, now_s: Callable[[], float] = time.monotonic) -> None:
        self._trial_count = total
        self._now_s = now_s
        self._ended_count = 0
        self._printed_s = now_s()

    def trial_ended(self, ending: Ending) -> None:
        """Count a trial that has ended, and print a line to stderr.

        No line is printed within LINE_INTERVAL_S of the last one.
        """
        self._ended_count += 1
        now_s = self._now_s()
        if now_s - self._printed_s < LINE_INTERVAL_S:
            return
        self._printed_s = now_s
        parts = [f"{self._ended_count} of {self._trial_count} trials", _remaining_time(ending)]
        print("; ".join(filter(None, parts)), file=sys.stderr, flush=True)


class NotebookProgress(RunObserver):
    """The progress of trials in a notebook: one output of the cell, a bar that grows.

    Args:
        total: Number of trials.
        display: IPython's function of this name, which every front end supports.
        now_s: Returns the time [s].
    """

    def __init__(
        self,
        total: int,
        display: Callable[..., Any],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._trial_count = total
        self._now_s = now_s
        self._ended_count = 0
        self._left = ""
        self._shown_s = now_s()
        self._output = display(self, display_id=True)

    def trial_ended(self, ending: Ending) -> None:
        """Count a trial that has ended, and change the bar.

        The bar changes at most every BAR_INTERVAL_S, and when all trials have ended.
        """
        self._ended_count += 1
        self._left = _remaining_time(ending)
        now_s = self._now_s()
        if self._ended_count == self._trial_count or now_s - self._shown_s >= BAR_INTERVAL_S:
            self._shown_s = now_s
            self._output.update(self)

    def __repr__(self) -> str:
        parts = [f"{self._ended_count} of {self._trial_count} trials"]
        if self._ended_count < self._trial_count:
            parts.append(self._left)
        return "; ".join(filter(None, parts))

    def _repr_html_(self) -> str:
        return (
            f'<progress value="{self._ended_count}" max="{self._trial_count}"></progress> {self!r}'
        )


def _remaining_time(ending: Ending) -> str:
    """Describe how long the remaining trials will take, or return "" if that is unknown."""
    return "" if ending.remaining_s is None else f"{format_duration(ending.remaining_s)} left"


def format_trial_line(task: Task, result: Result, unit: str) -> str:
    """Format the line about a finished trial.

    Args:
        task: The trial.
        result: Its result.
        unit: The experiment's length unit.
    """
    entered = ", entered an obstacle" if result.entered_obstacle else ""
    reason = f" ({result.reason})" if result.outcome == "aborted" else ""
    return (
        f"trial {task.trial + 1} of {task.trial_count}: {result.outcome}{reason}, total error "
        f"{result.total_error:.1f} {unit}, {result.steps} steps, {result.duration_s:.1f} s{entered}"
    )


def format_duration(seconds: float) -> str:
    """Format a time, rounded to whole seconds, for example as 45 s, 3 min 20 s or 2 h 5 min.

    From one hour on, seconds are left out.

    Args:
        seconds: The time [s]. A negative time counts as 0.
    """
    whole_s = max(round(seconds), 0)
    if whole_s < 60:
        return f"{whole_s} s"
    if whole_s < 3600:
        return f"{whole_s // 60} min {whole_s % 60} s"
    return f"{whole_s // 3600} h {whole_s % 3600 // 60} min"
